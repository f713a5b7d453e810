"""How well predictors foresee motion: joint errors, boxes, honesty (docs/predictor-evaluation.md).

A *window* is one person in `history_slots` consecutive slots, in each of which at least one joint
is known; the predictor is given these and asked for the slots that follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig
from e3pose.errors import InputError
from e3pose.evaluate.motion import HIPS, Motion, body_errors, body_joints, disturbed
from e3pose.occlusion import box_iou, person_boxes
from e3pose.predictors.base import Prediction, Predictor

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEADS = (1, 2, 3, 5, 8, 10, 15)
MAX_LEAD = 300
MAX_HISTORY = 1000
BATCH = 256  # windows a call; people of one slot to the predictor
MM = 1000.0


@dataclass(frozen=True, slots=True)
class PredictionSettings:
    """How predictors are measured.

    Attributes:
        leads: slots ahead, each at least 1.
        history_slots: the paper's M, slots that the predictor is given.
        noise_m: standard deviation of the noise in each coordinate of noisy histories, metres.
        missing: share of joints missing in noisy histories, [0, 1).
        seed: of noise and missing joints.
        every: a window in every so many slots.
    """

    leads: tuple[int, ...] = LEADS
    history_slots: int = 10
    noise_m: float = 0.02
    missing: float = 0.2
    seed: int = 0
    every: int = 1

    def __post_init__(self) -> None:
        if not self.leads or any(not 1 <= lead <= MAX_LEAD for lead in self.leads):
            raise InputError(f"leads: found {self.leads}, expected slots from 1 to {MAX_LEAD}")
        if not 1 <= self.history_slots <= MAX_HISTORY:
            raise InputError(
                f"history: found {self.history_slots} slots, expected 1 to {MAX_HISTORY}"
            )
        if not 0 <= self.noise_m <= 1:
            raise InputError(f"noise: found {MM * self.noise_m:g} mm, expected 0 to 1000")
        if not 0 <= self.missing < 1:
            raise InputError(f"missing: found {self.missing:g}, expected a share in [0, 1)")
        if self.seed < 0 or self.every < 1:
            raise InputError(
                f"seed and every: found {self.seed} and {self.every}, expected at least 0 and 1"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Tally:
    """Sums per lead, `(num_leads,)` each, which add up over windows and recordings.

    Attributes:
        wanted: joints whose future is known.
        found: of these, predicted ones.
        error_m: their distances.
        rooted: joints that can be told relative to the middle of the hips.
        rooted_error_m: their distances.
        claimed: joints for which the predictor stated an expected error.
        claim_m: these expected errors.
        within: joints no farther off than stated.
        within_twice: joints no farther off than twice that.
        boxes: people in views.
        iou: overlap of their predicted boxes with the actual ones.
        windows: windows with a known future, in which one joint suffices.
    """

    wanted: Floats
    found: Floats
    error_m: Floats
    rooted: Floats
    rooted_error_m: Floats
    claimed: Floats
    claim_m: Floats
    within: Floats
    within_twice: Floats
    boxes: Floats
    iou: Floats
    windows: Floats

    @classmethod
    def zero(cls, num_leads: int) -> Tally:
        """Return the tally of nothing."""
        return cls(*(np.zeros(num_leads) for _ in fields(cls)))

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def conditions(motion: Motion, settings: PredictionSettings) -> dict[str, tuple[Floats, ...]]:
    """Return the histories that predictors are given: `exact` and `noisy`, or `estimated`."""
    if motion.source == "estimates":  # noisy and gappy as they are
        return {"estimated": motion.people}
    noisy = disturbed(motion, settings.noise_m, settings.missing, settings.seed)
    return {"exact": motion.people, "noisy": noisy}


def count_windows(motion: Motion, settings: PredictionSettings) -> int:
    """Return how many windows a motion has."""
    return sum(len(window_ends(joints_m, settings)) for joints_m in motion.people)


def window_ends(joints_m: Floats, settings: PredictionSettings) -> Ints:
    """Return the newest slots of the windows of a person `(num_slots, num_joints, 3)`."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(joints_m).all(axis=-1).any(axis=-1))
    length = settings.history_slots
    if len(known) <= length:
        return np.zeros(0, dtype=np.int64)
    counts = np.convolve(known, np.ones(length), mode="valid")[:-1]
    ends = np.flatnonzero(counts > length - 0.5) + length - 1
    return ends[:: settings.every].astype(np.int64)


def score(
    predictor: Predictor, motion: Motion, seen: Sequence[Floats], settings: PredictionSettings
) -> Iterator[tuple[int, Tally]]:
    """Predict all windows of a motion.

    Args:
        predictor: for the motion's skeleton.
        motion: what really happened.
        seen: the people as the predictor is given them, each `(num_slots, num_joints, 3)`.
        settings: how to measure.

    Yields:
        Tallies of up to 256 windows with their number; add them up.
    """
    furthest = max(settings.leads)
    indices = np.array(settings.leads) - 1
    before = np.arange(1 - settings.history_slots, 1)
    for joints_m, given in zip(motion.people, seen, strict=True):
        ends = window_ends(joints_m, settings)
        unknown = np.full((furthest, *joints_m.shape[1:]), np.nan)
        future = body_joints(np.concatenate([joints_m, unknown]), motion.skeleton)
        boxes = actual_boxes(motion.rig, future)
        for batch in np.split(ends, range(BATCH, len(ends), BATCH)):
            if not len(batch):
                continue
            history = np.swapaxes(given[batch[:, None] + before], 0, 1)
            result = predictor.predict(history, motion.interval_s, furthest)
            wanted = batch + np.array(settings.leads)[:, None]  # (num_leads, num_windows)
            kept = Prediction(
                body_joints(result.joints_m[indices], motion.skeleton),
                body_errors(result.error_m[indices], motion.skeleton),
            )
            yield len(batch), tally(kept, future[wanted], motion.rig, boxes[:, wanted])


def tally(predicted: Prediction, actual_m: Floats, rig: Rig, boxes: Floats) -> Tally:
    """Compare predictions with what happened.

    Args:
        predicted: of `(num_leads, num_windows, 14)` body joints.
        actual_m: `(num_leads, num_windows, 14, 3)` metres, NaN where unknown.
        rig: the cameras.
        boxes: `(num_cameras, num_leads, num_windows, 4)` the actual boxes, NaN where not in view.
    """
    known = np.asarray(np.isfinite(actual_m).all(axis=-1))
    joints_m = np.where(known[..., None], predicted.joints_m, np.nan)
    distance = np.linalg.norm(joints_m - actual_m, axis=-1)
    rooted = np.linalg.norm(_rooted(joints_m) - _rooted(actual_m), axis=-1)
    claim = np.where(np.isfinite(distance), predicted.error_m, np.nan)
    overlap, counted = _overlap(joints_m, rig, boxes)
    with np.errstate(invalid="ignore"):
        within, within_twice = distance <= claim, distance <= 2 * claim
    return Tally(
        wanted=_count(known),
        found=_count(np.isfinite(distance)),
        error_m=_sum(distance),
        rooted=_count(np.isfinite(rooted)),
        rooted_error_m=_sum(rooted),
        claimed=_count(np.isfinite(claim)),
        claim_m=_sum(claim),
        within=_count(within),
        within_twice=_count(within_twice),
        boxes=counted,
        iou=overlap,
        windows=known.any(axis=-1).sum(axis=-1).astype(np.float64),
    )


def actual_boxes(rig: Rig, body_m: Floats) -> Floats:
    """Return `(num_cameras, *batch, 4)` boxes of people `(*batch, 14, 3)` in every view, pixels."""
    return np.stack([person_boxes(c.project(body_m), c.image_size) for c in rig.cameras])


def figures(total: Tally, leads: Sequence[int]) -> dict[str, dict[str, float]]:
    """Return the figures by name and lead; one that cannot be had is absent."""
    ratios = {
        "mpjpe_mm": (MM * total.error_m, total.found),
        "root_relative_mpjpe_mm": (MM * total.rooted_error_m, total.rooted),
        "coverage": (total.found, total.wanted),
        "box_iou": (total.iou, total.boxes),
        "expected_mm": (MM * total.claim_m, total.claimed),
        "within_expected": (total.within, total.claimed),
        "within_twice_expected": (total.within_twice, total.claimed),
    }
    by_name = {
        name: {
            str(lead): float(part / whole)
            for lead, part, whole in zip(leads, parts, wholes, strict=True)
            if whole > 0
        }
        for name, (parts, wholes) in ratios.items()
    }
    return {name: by_lead for name, by_lead in by_name.items() if by_lead}


def latencies_ms(
    predictor: Predictor,
    history_m: Floats,
    interval_s: float,
    leads: Sequence[int],
    clock: Callable[[], float],
    repeats: int = 50,
) -> Mapping[str, Mapping[str, float]]:
    """Time single calls for all people of one slot.

    Args:
        predictor: the one to time.
        history_m: `(num_slots, num_persons, num_joints, 3)` metres.
        interval_s: seconds a slot.
        leads: slots ahead.
        clock: seconds.
        repeats: calls per lead, after one that does not count.

    Returns:
        Per lead the `median` and `p99` in milliseconds.
    """
    result = {}
    for lead in leads:
        predictor.predict(history_m, interval_s, lead)
        times = []
        for _ in range(repeats):
            started = clock()
            predictor.predict(history_m, interval_s, lead)
            times.append(MM * (clock() - started))
        result[str(lead)] = {
            "median": float(np.median(times)),
            "p99": float(np.percentile(times, 99)),
        }
    return result


def _rooted(body_m: Floats) -> Floats:
    return np.asarray(body_m - body_m[..., HIPS, :].mean(axis=-2, keepdims=True))


def _overlap(joints_m: Floats, rig: Rig, boxes: Floats) -> tuple[Floats, Floats]:
    """Return the summed IoU and the number of people in views, per lead."""
    overlap = np.zeros(len(joints_m))
    counted = np.zeros(len(joints_m))
    for camera, actual in zip(rig.cameras, boxes, strict=True):
        in_view = np.isfinite(actual).all(axis=-1)
        iou = box_iou(person_boxes(camera.project(joints_m), camera.image_size), actual)
        overlap += np.where(in_view, iou, 0.0).sum(axis=-1)
        counted += in_view.sum(axis=-1)
    return overlap, counted


def _sum(values: Floats) -> Floats:
    return np.asarray(np.nansum(values, axis=tuple(range(1, values.ndim))))


def _count(flags: NDArray[np.bool_]) -> Floats:
    return np.asarray(flags.sum(axis=tuple(range(1, flags.ndim))), dtype=np.float64)
