"""Errors of predictors: joints, boxes, calibration (docs/reference/predictor-metrics.md).

A *window* is one person in `history_slots` consecutive slots, in each of which at least one joint
is known; the predictor is given these and asked for the slots that follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.predict.base import Prediction, Predictor
from e3pose.select.occlusion import person_boxes
from e3pose_lab.prediction.motion import Motion, body_errors, body_joints, disturbed
from e3pose_lab.prediction.tally import MM, Tally, tally

LEADS = (1, 2, 3, 5, 8, 10, 15)
MAX_LEAD = 300
MAX_HISTORY = 1000
BATCH = 256  # windows a call; people of one slot to the predictor


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


def conditions(motion: Motion, settings: PredictionSettings) -> dict[str, tuple[Floats, ...]]:
    """Return the histories that predictors are given: `exact` and `noisy`, or `estimated`."""
    if motion.source == "estimates":  # noisy and gappy as they are
        return {"estimated": motion.people}
    noisy = disturbed(motion, settings.noise_m, settings.missing, settings.seed)
    return {"exact": motion.people, "noisy": noisy}


def count_windows(motion: Motion, settings: PredictionSettings) -> int:
    """Return how many windows a motion has."""
    return sum(len(window_ends(joints_m, settings)) for joints_m in motion.people)


def window_ends(joints_m: Floats, settings: PredictionSettings) -> Integers:
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
        cameras = motion.rig.cameras  # (num_cameras, *batch, 4) boxes of people in every view
        boxes = np.stack([person_boxes(c.project(future), c.image_size) for c in cameras])
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
        interval_s: seconds per slot.
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
