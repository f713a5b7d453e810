"""The figures of one replay as records, and their JSON.

`docs/reference/metrics.md` says what each figure is. One that cannot be had (no truth, no match)
is None in a record and absent in JSON, never 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.profiles import DeviceProfile, Mode, load_profile
from e3pose.energy.queues import mean_watts, paper_percent
from e3pose.energy.saving import NO_SAVINGS, Saving, Savings, charged, saving
from e3pose.evaluate.metrics import MATCH_LIMIT_M, mean_errors_m
from e3pose.model.blind_slot import duty_of, seeing
from e3pose.model.uncertainty import distance_within_m, expected_distance_m
from e3pose.recording import Recording
from e3pose.settings.energy import AWAKE
from e3pose.settings.faults import Faults
from e3pose.settings.loop import LoopSettings

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord


# The devices of the paper, and what 3 of 5 cameras per slot save on each of them: percent of the
# power of CPU, GPU, WiFi and memory, lowest and highest.
PAPER_SAVINGS = {"xavier-nx": (20.66, 31.21), "tx2": (17.72, 28.67)}
PAPER_DUTY = 3 / 5


def modelled_watts(
    records: Sequence[SlotRecord],
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
    sends_boxes: bool = False,
    slept_w: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Return `(num_cameras,)` mean power by profiles, and that of an active camera, watts.

    With `sends_boxes` every idle camera sends in each slot that is decided for: its WiFi draws what
    it does in an active slot. `slept_w` `(num_cameras,)` is what sleep took off the mean draw.
    """
    counted = seeing(records, len(profiles))
    sending = _sending(counted) if sends_boxes and len(counted) else 0.0
    watts = mean_watts(duty_of(counted), profiles, idle_mode, sending)
    if slept_w is not None:
        watts = watts - slept_w
    return watts, np.array([each.watts("active") for each in profiles])


def charged_watts(
    records: Sequence[SlotRecord],
    charged_j: Floats,
    profiles: Sequence[DeviceProfile],
    interval_s: float,
) -> tuple[Floats, Floats]:
    """Return the same of slots that were stored with the joules they are charged with.

    Args:
        records: one per slot, of which those that are not blind count.
        charged_j: `(num_slots, num_cameras)` joules.
        profiles: `(num_cameras,)` what the cameras draw.
        interval_s: of a slot.
    """
    sees = np.array([not record.blind for record in records])
    selected = np.stack([record.selected for record in records])
    active_j = interval_s * np.array([each.watts("active") for each in profiles])
    spent_j, always_j = charged(selected[sees], charged_j[sees], active_j)
    seconds = max(int(sees.sum()), 1) * interval_s
    return spent_j / seconds, always_j / seconds


def energy_figures(
    recording: Recording,
    records: Sequence[SlotRecord],
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
    battery_wh: float | Sequence[float],
    drawn: tuple[Floats, Floats],
    sends_boxes: bool = False,
) -> Energy | None:
    """Return the figures of `docs/explanation/energy.md`; None without a slot, or if all are blind.

    Blind slots are charged as the mean of the others is. `drawn` is mean and active power of each
    camera, watts.
    """
    watts, active_w = drawn
    counted = seeing(records, len(watts))
    if not len(counted):
        return None
    batteries_wh = np.broadcast_to(np.asarray(battery_wh, dtype=np.float64), watts.shape)
    duty = float(duty_of(counted).mean())
    sending = float(_sending(counted).mean()) if sends_boxes else 0.0
    seconds = len(records) * recording.interval_s
    return Energy(
        profile=", ".join(dict.fromkeys(each.name for each in profiles)),
        idle_mode=idle_mode,
        watts_spread=float(np.std(watts, ddof=1)) if len(watts) > 1 else 0.0,
        cameras={
            camera_id: CameraEnergy(
                mean_watts=float(watts[n]),
                active_watts=float(active_w[n]),
                energy_j=float(watts[n] * seconds),
                battery_wh=float(batteries_wh[n]),
                battery_hours=float(batteries_wh[n] / watts[n]),
            )
            for n, camera_id in enumerate(recording.rig.camera_ids)
        },
        battery_wh=float(batteries_wh.mean()),
        battery_hours_always_active=float((batteries_wh / active_w).mean()),
        devices={name: _on_device(duty, sending, name) for name in PAPER_SAVINGS},
    )


def _sending(selected: Flags) -> Floats:
    """Return `(num_cameras,)` share of the slots in which a camera is idle, but others look."""
    return np.asarray((selected.any(axis=1, keepdims=True) & ~selected).mean(axis=0))


def _on_device(duty: float, sending: float, name: str) -> DeviceSaving:
    """Return the saving of cameras of one kind that are active in a share `duty` of the slots.

    In a share `sending` of the slots they are idle but send.

    `times_paper` is against the paper's 3 of 5 cameras, both by the same profile.
    """
    profile = load_profile(name)
    modes: tuple[Mode, Mode] = ("power-saving", "aggressive-power-saving")
    idle, aggressive = (paper_percent(duty, profile, mode, sending) for mode in modes)
    paper = paper_percent(PAPER_DUTY, profile)
    return DeviceSaving(idle, aggressive, idle / paper, aggressive / paper)


def processor_saving(
    recording: Recording, records: Sequence[SlotRecord], asleep: Flags | None, idle_mode: Mode
) -> Saving | None:
    """Return the saving of processor time by a selection, from measured looks and frames.

    Args:
        recording: with `processor`; None unless all cameras have it.
        records: one per slot, of which those that are not blind count.
        asleep: `(num_slots, num_cameras)` who captured nothing; None where everybody is awake.
        idle_mode: what cameras do that are not selected.
    """
    measured = [recording.processor.get(camera_id) for camera_id in recording.rig.camera_ids]
    known = [each for each in measured if each is not None]
    sees = np.array([not record.blind for record in records], dtype=bool)
    if not sees.any() or not known or len(known) < len(measured):
        return None
    look_s = np.array([each.look_s for each in known])
    frame_s = np.array([each.frame_s for each in known])
    looks = np.stack([record.selected for record in records])
    captures = looks if idle_mode == "aggressive-power-saving" else np.ones_like(looks)
    if asleep is not None:
        captures = (captures & ~asleep) | looks
    spent_s = (looks * look_s + captures * frame_s)[sees].sum(axis=0)
    return saving(spent_s, sees.sum() * (look_s + frame_s), measured=False)


MM = 1000.0
BAND = 0.9


def expected_figures(recording: Recording, records: Sequence[SlotRecord]) -> Expected:
    """Return the expected error of shown joints, against the actual one where truth is known.

    With truth in the recording's own skeleton also of the joints of people matched within 500 mm.
    """
    error_mm = foreseen_mm = None
    total_m, count = 0.0, 0
    for record in records:
        expected_m = expected_distance_m(record.people.covariance_m2)
        known = ~np.isnan(expected_m)
        total_m, count = total_m + float(expected_m[known].sum()), count + int(known.sum())
    if count:
        error_mm = MM * total_m / count
    foreseen = [record.reasons.error_m for record in records if record.reasons is not None]
    if np.isfinite(foreseen).any():
        foreseen_mm = MM * float(np.nanmean(foreseen))
    truth = recording.truth
    if truth is None or truth.skeleton != recording.skeleton or not count:
        return Expected(error_mm, foreseen_mm)
    first, stop = recording.scored_slots or (0, recording.num_slots)
    pairs = [
        _matched(record, truth.joints_m[record.slot])
        for record in records
        if first <= record.slot < stop and np.isfinite(record.people.covariance_m2).any()
    ]
    expected, within, actual = (np.concatenate(part) for part in zip(*pairs, strict=True))
    if not len(actual):
        return Expected(error_mm, foreseen_mm)
    return Expected(
        error_mm,
        foreseen_mm,
        matched_mm=MM * float(expected.mean()),
        actual_mm=MM * float(actual.mean()),
        coverage_90=100 * float((actual <= within).mean()),
    )


def _matched(record: SlotRecord, truth_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return expected errors, 90 % distances and actual errors of the joints of matched people."""
    from scipy.optimize import linear_sum_assignment

    joints_m = record.people.joints_m
    gain = np.maximum(MATCH_LIMIT_M - mean_errors_m(joints_m, truth_m), 0.0)
    persons, actors = linear_sum_assignment(gain, maximize=True)
    right = gain[persons, actors] > 0
    persons, actors = persons[right], actors[right]
    actual = np.linalg.norm(joints_m[persons] - truth_m[actors], axis=-1)
    covariance = record.people.covariance_m2[persons]
    known = np.isfinite(actual) & np.isfinite(covariance).all(axis=(-1, -2))
    spread = covariance[known]
    return expected_distance_m(spread), distance_within_m(spread, BAND), actual[known]


FORMAT = "e3pose-figures"
VERSION = 2  # 1 had other savings, in `energy` and `processor`
OWN = ("policy", "predictor", "estimator")  # settings that may be objects
OF_RESTS = ("rest", "find_within_s")  # mean nothing while nobody rests


@dataclass(frozen=True, slots=True)
class Pcp:
    """Percentage of correct parts on Shelf.

    Attributes:
        actors: by actor, and `average` over actors 1-3.
        groups: the same by limb group.
    """

    actors: Mapping[str, float]
    groups: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy by the truth of a recording, over its scored slots."""

    scored_slots: int | None = None
    pcp: Pcp | None = None
    mpjpe_mm: float | None = None
    p95_mm: float | None = None
    p99_mm: float | None = None
    wrong_limbs_percent: float | None = None
    wrong_limbs: Mapping[str, float] | None = None
    recall_500mm: float | None = None
    joint_coverage: float | None = None
    id_switches: int | None = None
    acceleration_error_mps2: float | None = None
    precision_500mm: float | None = None
    ap: Mapping[str, float] | None = None
    poses_within: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances of projected joints from the keypoints of a held-out camera.

    Attributes:
        keypoints: how many are compared.
        mean_px: in the image.
        median_px: likewise.
        mean_mm: across the ray, at the depth of the joint.
        median_mm: likewise.
        limbs: how many are compared; of a joint those that end in it.
        wrong_limbs_percent: of these (`evaluate.wrong_limbs`).
    """

    keypoints: int = 0
    mean_px: float | None = None
    median_px: float | None = None
    mean_mm: float | None = None
    median_mm: float | None = None
    limbs: int = 0
    wrong_limbs_percent: float | None = None


@dataclass(frozen=True, slots=True)
class HeldOutCamera(Distances):
    """Agreement with one held-out camera, over the scored slots.

    Attributes:
        people: its detections that count.
        missed_percent: those without a pose.
        poses: that should be in its image.
        unseen_percent: those without a detection: hidden from it, or nobody.
        shift_px: right and down, by which its keypoints are off in the median; of a camera alone.
        joints: distances by joint.
    """

    people: int = 0
    missed_percent: float | None = None
    poses: int = 0
    unseen_percent: float | None = None
    shift_px: tuple[float, float] | None = None
    joints: Mapping[str, Distances] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Agreement with all held-out cameras.

    Attributes:
        cameras: by camera id.
        mean: over them; counts are summed.
    """

    cameras: Mapping[str, HeldOutCamera]
    mean: HeldOutCamera


@dataclass(frozen=True, slots=True)
class Expected:
    """The expected errors of the estimator, and whether they are right.

    Attributes:
        error_mm: the mean expected error of all shown joints.
        foreseen_mm: the mean of what was expected of a slot when its cameras were chosen.
        matched_mm: what was expected of the joints of people matched within 500 mm.
        actual_mm: how far off those were.
        coverage_90: the share of them, in percent, within the distance that was to hold 90 %.
    """

    error_mm: float | None = None
    foreseen_mm: float | None = None
    matched_mm: float | None = None
    actual_mm: float | None = None
    coverage_90: float | None = None


@dataclass(frozen=True, slots=True)
class Selected:
    """Selection; shares of the slots by camera.

    Attributes:
        mean_cameras: cameras selected per slot, blind slots left out.
        mean_views: views that arrived per slot.
        duty: share of the slots in which each camera was selected, blind slots left out.
        blind: blind slots by cause; causes that did not occur are absent.
    """

    mean_cameras: float
    mean_views: float
    duty: Mapping[str, float]
    blind: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Deficits:
    """The virtual queues by camera, in slots."""

    final: Mapping[str, float]
    highest: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class CameraEnergy:
    """The energy of one camera."""

    mean_watts: float
    active_watts: float
    energy_j: float
    battery_wh: float
    battery_hours: float


@dataclass(frozen=True, slots=True)
class DeviceSaving:
    """The saving of CPU, GPU, WiFi and memory on a device of the paper.

    `times_paper` is against the paper's 3 of 5 cameras.
    """

    saving_percent: float
    aggressive_saving_percent: float
    times_paper: float
    aggressive_times_paper: float


@dataclass(frozen=True, slots=True)
class Energy:
    """The energy of a selection.

    `watts_spread` is the standard deviation of the cameras' mean powers.
    """

    profile: str
    idle_mode: str
    watts_spread: float
    cameras: Mapping[str, CameraEnergy]
    battery_wh: float
    battery_hours_always_active: float
    devices: Mapping[str, DeviceSaving]


@dataclass(frozen=True, slots=True)
class Duration:
    """The duration of a stage, milliseconds."""

    median: float
    p99: float


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """The noise file in use, and the noise learned of each camera by the last slot.

    Attributes:
        file: its name.
        factors: by camera, sigma of its keypoints over what the file states.
    """

    file: str
    factors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of one replay.

    Attributes:
        recording: its name.
        slots: how many there were.
        policy: who decided.
        settings: how it was replayed, with all that follows from the rig.
        identities: how many were given.
        metrics: against the truth; None of its figures without one.
        expected: errors that the estimator stated.
        selection: shares by camera; None without a slot, and so on.
        deficits: the virtual queues.
        energy: spent.
        stage_ms: by stage, and `slot` for all of them.
        noise: of the keypoints; None of an estimator that does not learn it.
        smooth: how the poses were smoothed after the replay; None if they were not.
        notes: what a page should say beside, sentence by sentence.
        held_out: distances from the keypoints of held-out cameras, if any.
        reprojection: the same of the cameras that took part, where all of them always did.
        doubts: why nobody should trust the poses, the worst first.
        savings: against all cameras active in every slot.
    """

    recording: str
    slots: int
    policy: str
    settings: LoopSettings
    identities: int
    metrics: Accuracy
    expected: Expected
    selection: Selected | None
    deficits: Deficits | None
    energy: Energy | None
    stage_ms: Mapping[str, Duration]
    noise: NoiseFound | None
    smooth: str | None = None
    notes: tuple[str, ...] = ()
    held_out: HeldOut | None = None
    reprojection: HeldOut | None = None
    doubts: tuple[str, ...] = ()
    savings: Savings = NO_SAVINGS

    @property
    def all_looked(self) -> bool:
        """Whether every camera was active in every slot, so that there is nothing to save."""
        return self.selection is not None and min(self.selection.duty.values(), default=0) >= 1


def as_json(summary: Summary, **more: Any) -> dict[str, Any]:
    """Return figures as the JSON that is written to files.

    Args:
        summary: the figures.
        more: further tables, at the end.
    """
    table: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    for item in fields(summary):
        value = getattr(summary, item.name)
        table[item.name] = {} if value is None else plain(value)
    table["settings"] = settings_json(summary.settings)
    if table.pop("smooth"):
        table["settings"]["smooth"] = summary.smooth
    notes = table.pop("notes")
    for name in ("held_out", "reprojection", "doubts"):
        if not table[name]:
            del table[name]
    return {**table, **more, **({"notes": notes} if notes else {})}


def settings_json(settings: LoopSettings) -> dict[str, Any]:
    """Return settings as JSON: unset ones are absent, parts of one's own are named."""
    table: dict[str, Any] = {}
    for item in fields(settings):
        if item.name in OF_RESTS and settings.rest == AWAKE:
            continue
        value = getattr(settings, item.name)
        if item.name in OWN and not isinstance(value, str | None):
            value = type(value).__name__
        if value is not None and item.name != "rest_costs":
            table[item.name] = asdict(value) if isinstance(value, Faults) else value
    return table


def plain(value: Any) -> Any:
    """Return nested records as dictionaries and lists, without None."""
    if isinstance(value, Pcp):
        return {**value.actors, "groups": plain(value.groups)}
    if is_dataclass(value) and not isinstance(value, type):
        found = {item.name: getattr(value, item.name) for item in fields(value)}
        return {name: plain(each) for name, each in found.items() if each is not None}
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, tuple | list) else value
