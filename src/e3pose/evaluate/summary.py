"""The figures of one replay: accuracy against the truth, selection, energy, stage times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.energy.profiles import DeviceProfile, Mode
from e3pose.energy.queues import DEFAULT_BATTERY_WH
from e3pose.energy.saving import Savings, saving
from e3pose.evaluate import metrics
from e3pose.evaluate.figures import (
    Accuracy,
    Deficits,
    Duration,
    NoiseFound,
    Pcp,
    Selected,
    Summary,
    charged_watts,
    energy_figures,
    expected_figures,
    modelled_watts,
    processor_saving,
)
from e3pose.evaluate.metrics import count_parts, group_percent, pcp_percent
from e3pose.evaluate.waking import asleep_in
from e3pose.evaluate.wrong_limbs import wrong_percent
from e3pose.model.blind_slot import count_blind, duty, seeing
from e3pose.model.noises import detector_of
from e3pose.model.people import People
from e3pose.model.skeleton import PANOPTIC19, SHELF14, Skeleton, convert
from e3pose.recording import Recording
from e3pose.select.policies import Need
from e3pose.settings.parts import row_of

if TYPE_CHECKING:
    from e3pose.evaluate.replay import ReplaySettings
    from e3pose.pipeline import SlotRecord


AP_LIMITS_MM = (25, 50, 75, 100, 105, 125, 150)  # the paper reports 25, 50, 105, 150
PANOPTIC_JOINTS = 15  # the protocol leaves out eyes and ears


def summarise(
    recording: Recording,
    settings: ReplaySettings,
    records: Sequence[SlotRecord],
    profile: DeviceProfile | Sequence[DeviceProfile],
    *,
    idle_mode: Mode = "power-saving",
    battery_wh: float | Sequence[float] = DEFAULT_BATTERY_WH,
    charged_j: Floats | None = None,
) -> Summary:
    """Summarise a replay; `docs/reference/metrics.md` defines each figure.

    Args:
        recording: what was replayed; its truth is first read here.
        settings: how it was replayed.
        records: one per slot.
        profile: what the cameras draw, one for all or one for each.
        idle_mode: what a camera does in slots for which it is not selected.
        battery_wh: capacity of the cameras' batteries, one for all or one for each.
        charged_j: `(num_slots, num_cameras)` joules that a live site charged its slots with; None:
            by the profiles.
    """
    profiles = [profile] * len(recording.rig) if isinstance(profile, DeviceProfile) else profile
    sends_boxes = Need.SENT_BOXES in row_of(settings).needs
    if charged_j is None:
        slept_w = _slept_w(recording, settings, records)
        drawn = modelled_watts(records, profiles, idle_mode, sends_boxes, slept_w)
    else:
        drawn = charged_watts(records, charged_j, profiles, recording.interval_s)
    seconds = recording.interval_s * len(seeing(records, len(profiles)))
    rests = bool(records) and settings.rest_costs is not None
    asleep = asleep_in(records, settings.lead_slots) if rests else None
    return Summary(
        recording=recording.name,
        slots=len(records),
        policy=settings.row_name,
        settings=settings.for_rig(len(recording.rig)),
        identities=len({track_id for r in records for track_id in r.people.track_ids.tolist()}),
        metrics=accuracy(recording, records),
        expected=expected_figures(recording, records),
        selection=_selection(recording, records),
        deficits=_deficits(recording, records),
        energy=energy_figures(
            recording, records, profiles, idle_mode, battery_wh, drawn, sends_boxes
        ),
        stage_ms=_stage_ms(records),
        noise=_noise(recording, settings, records),
        savings=Savings(
            saving(seconds * drawn[0], seconds * drawn[1], measured=False),
            processor_saving(recording, records, asleep, idle_mode),
        ),
    )


def _slept_w(
    recording: Recording, settings: ReplaySettings, records: Sequence[SlotRecord]
) -> Floats | None:
    """Return `(num_cameras,)` watts that sleep took off the mean draw; None where nobody may."""
    costs = settings.rest_costs
    if costs is None or not records:
        return None
    deep = costs.deep(asleep_in(records, settings.lead_slots), recording.interval_s)
    return np.asarray((costs.idle_w - costs.rest_w) * deep.mean(axis=0))


def accuracy(recording: Recording, records: Sequence[SlotRecord]) -> Accuracy:
    """Return the metrics that the recording's truth allows, over its scored slots.

    A scored slot without a record counts as one without predictions. AP and precision need a truth
    that holds everybody in the scene; PCP is of Shelf-14 truth alone.
    """
    truth = recording.truth
    if truth is None:
        return Accuracy()
    first, stop = recording.scored_slots or (0, recording.num_slots)
    true_joints = truth.joints_m[first:stop]
    by_slot = {record.slot: record for record in records}
    scored = [by_slot.get(slot) for slot in range(first, stop)]
    predicted = in_skeleton(scored, recording.skeleton, truth.skeleton)
    scores = [  # of each person, in which a missing joint counts 0
        np.zeros(0) if record is None else record.people.scores.mean(axis=-1) for record in scored
    ]
    pcp = None
    if truth.skeleton == SHELF14:
        counts = count_parts(predicted, true_joints)
        actors = pcp_percent(counts, truth.person_ids)
        pcp = Pcp(actors, group_percent(counts, truth.person_ids)) if actors else None
    kept = slice(0, PANOPTIC_JOINTS if truth.skeleton == PANOPTIC19 else None)
    rooted = np.where(_has_root(true_joints, truth.skeleton)[..., None, None], true_joints, np.nan)
    rooted = rooted[..., kept, :]
    people = [joints[:, kept] for joints in predicted]
    found = metrics.candidates(people, scores, rooted)
    names = truth.skeleton.joints[kept]
    wrong = metrics.wrong_limbs(found, names)
    wrong_by_joint = {
        name: percent
        for name, each in zip(names, wrong.T, strict=True)
        if (percent := wrong_percent(each)) is not None
    }
    ids = [np.zeros(0, np.int64) if r is None else r.people.track_ids for r in scored]
    whole, known = recording.truth_complete, found.num_truths > 0
    return Accuracy(
        scored_slots=len(scored),
        pcp=pcp,
        mpjpe_mm=metrics.mpjpe_mm(found),
        p95_mm=metrics.joint_quantile_mm(found, 0.95),
        p99_mm=metrics.joint_quantile_mm(found, 0.99),
        wrong_limbs_percent=wrong_percent(wrong),
        wrong_limbs=wrong_by_joint or None,
        recall_500mm=metrics.recall_500mm(found),
        joint_coverage=metrics.joint_coverage(found),
        id_switches=metrics.id_switches(people, ids, rooted) if known else None,
        acceleration_error_mps2=metrics.acceleration_error_mps2(
            people, ids, rooted, recording.interval_s
        )
        if known
        else None,
        precision_500mm=metrics.precision_500mm(found) if whole else None,
        ap=_by_limit(found, metrics.average_precision) if whole else None,
        poses_within=_by_limit(found, metrics.poses_within) if whole else None,
    )


def _by_limit(
    found: metrics.Candidates, metric: Callable[[metrics.Candidates, float], float | None]
) -> dict[str, float] | None:
    """Return a metric at every limit, in millimetres; None if one cannot be had."""
    known: dict[str, float] = {}
    for limit_mm in AP_LIMITS_MM:
        percent = metric(found, limit_mm / 1000)
        if percent is None:
            return None
        known[f"{limit_mm}"] = percent
    return known


def in_skeleton(
    scored: Sequence[SlotRecord | None], source: Skeleton, target: Skeleton
) -> list[Floats]:
    """Express the people of all slots in the truth's skeleton, in one conversion."""
    counts = [0 if record is None else len(record.people) for record in scored]
    people = People.joined([r.people for r in scored if r is not None], len(source))
    joints_m, _ = convert(people.joints_m, people.scores, source, target)
    return np.split(joints_m, np.cumsum(counts)[:-1]) if counts else []


def _has_root(joints_m: Floats, skeleton: Skeleton) -> NDArray[np.bool_]:
    """Return `(*batch)`: whether the body centre, hips or root in its stead, is annotated."""
    root = skeleton.joints[skeleton.parents.index(-1)]
    centres = ("mid_hip",), ("left_hip", "right_hip"), (root,)
    names = next(each for each in centres if {*each} <= {*skeleton.joints})
    roots = joints_m[..., [skeleton.index(name) for name in names], :]
    return np.asarray(np.isfinite(roots).all(axis=(-1, -2)))


def _selection(recording: Recording, records: Sequence[SlotRecord]) -> Selected | None:
    if not records:
        return None
    shares = duty(records, len(recording.rig))
    arrived = np.stack([record.arrived for record in records])
    return Selected(
        mean_cameras=float(shares.sum()),
        mean_views=float(arrived.sum(axis=1).mean()),
        duty=_by_camera(recording, shares),
        blind=count_blind(records),
    )


def _deficits(recording: Recording, records: Sequence[SlotRecord]) -> Deficits | None:
    if not records:
        return None
    deficit = np.stack([record.deficit for record in records])
    return Deficits(
        final=_by_camera(recording, deficit[-1]),
        highest=_by_camera(recording, deficit.max(axis=0)),
    )


def _stage_ms(records: Sequence[SlotRecord]) -> dict[str, Duration]:
    stages: dict[str, list[float]] = {}
    for record in records:
        for stage, seconds in record.stage_s.items():
            stages.setdefault(stage, []).append(1000 * seconds)
    if records and stages:
        stages["slot"] = [1000 * sum(record.stage_s.values()) for record in records]
    return {
        stage: Duration(float(np.median(times)), float(np.percentile(times, 99)))
        for stage, times in stages.items()
    }


def _noise(
    recording: Recording, settings: ReplaySettings, records: Sequence[SlotRecord]
) -> NoiseFound | None:
    """Return the noise file in use, and the noise learned of each camera by the last slot."""
    factors = records[-1].noise_factors if records else None
    if factors is None:
        return None
    learned = _by_camera(recording, factors)
    return NoiseFound(
        file=settings.noise or detector_of(recording),
        factors={camera: round(factor, 3) for camera, factor in learned.items() if factor > 0},
    )


def _by_camera(recording: Recording, values: NDArray[Any]) -> Mapping[str, float]:
    return {c: float(v) for c, v in zip(recording.rig.camera_ids, values, strict=True)}
