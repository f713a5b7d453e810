"""Predictors without weights: a person stays, goes on as now, or slows down."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import ceil

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.predict.base import Prediction


def newest_known(history_m: Floats) -> tuple[Floats, Floats]:
    """Return the newest known position of every joint, and how old it is.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where unknown.

    Returns:
        `(num_tracks, num_joints, 3)` metres, NaN where the history never shows the joint, and
        `(num_tracks, num_joints)` slots since, 0 in the newest slot and where never shown.
    """
    position, age = np.empty(history_m.shape[1:]), np.empty(history_m.shape[1:3])
    find_newest(np.ascontiguousarray(history_m, dtype=np.float64), position, age)
    return position, age


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """Carry every joint on with its motion between the two newest slots (paper section 4.3).

    A joint that is missing in one of the two moves with the mean motion of the person's other
    joints, from where it was last known.
    """

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        joints_m = np.empty((lead_slots, *history_m.shape[1:]))
        go_on(np.ascontiguousarray(history_m, dtype=np.float64), joints_m)
        return Prediction.of_unknown_error(joints_m)


@dataclass(frozen=True, slots=True)
class ZeroVelocity:
    """Leave every joint where it was last known."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        position, _ = newest_known(history_m)
        return Prediction.of_unknown_error(np.repeat(position[None], lead_slots, axis=0))


FRAME_S = 1 / 30  # the time unit of span and decay
SPAN_FRAMES = 3
DECAY = 0.85  # of the velocity, every frame
ROUNDING = 1e-3  # so that 29.97 fps counts as 30


@dataclass(frozen=True, slots=True)
class DampedVelocity:
    """Carry every joint on with its mean velocity over 0.1 s, which decays by 0.85 a 1/30 s.

    Span and decay belong to time: at 30 fps they are three frames and 0.85 a frame, at other rates
    as many slots as 0.1 s has, at least one, and the same decay a second. A joint known in fewer
    than two slots of the span moves with the mean of the person's other joints, from where it was
    last known.
    """

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        span = max(1, ceil(SPAN_FRAMES * FRAME_S / interval_s - ROUNDING * SPAN_FRAMES))
        velocity = _mean_velocity(history_m[-(span + 1) :])
        position, age = newest_known(history_m)
        decay = DECAY ** (interval_s / FRAME_S)
        slots = np.arange(1, lead_slots + 1)[:, None, None] + age
        travelled = decay * (1 - decay**slots) / (1 - decay)  # decay + decay^2 + ... in slots
        return Prediction.of_unknown_error(position + travelled[..., None] * velocity)


def _mean_velocity(recent_m: Floats) -> Floats:
    """Return `(num_tracks, num_joints, 3)` metres per slot, from the first to the last known."""
    last, age = newest_known(recent_m)
    first, since_start = newest_known(recent_m[::-1])
    slots = len(recent_m) - 1 - age - since_start
    measured = (np.isfinite(last).all(axis=-1) & (slots > 0))[..., None]
    velocity = (last - first) / np.maximum(slots, 1)[..., None]
    count = np.maximum(measured.sum(axis=1, keepdims=True), 1)
    mean = np.where(measured, velocity, 0.0).sum(axis=1, keepdims=True) / count
    return np.where(measured, velocity, mean)


@kernel
def find_newest(history_m: Floats, position_m: Floats, age: Floats) -> None:
    """Fill the newest known position of every joint, and how old it is.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where unknown.
        position_m: `(num_tracks, num_joints, 3)` filled, NaN where the joint is never shown.
        age: `(num_tracks, num_joints)` filled: slots since, 0 where the joint is never shown.
    """
    num_slots = len(history_m)
    for track in range(age.shape[0]):
        for joint in range(age.shape[1]):
            age[track, joint] = 0.0
            for axis in range(3):
                position_m[track, joint, axis] = np.nan
            for back in range(num_slots):
                if _known(history_m[num_slots - 1 - back, track, joint]):
                    age[track, joint] = back
                    for axis in range(3):
                        place = history_m[num_slots - 1 - back, track, joint, axis]
                        position_m[track, joint, axis] = place
                    break


@kernel
def go_on(history_m: Floats, joints_m: Floats) -> None:
    """Fill `joints_m` with `ConstantVelocity.predict`.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where unknown.
        joints_m: `(num_leads, num_tracks, num_joints, 3)` metres.
    """
    num_leads, num_tracks, num_joints, _ = joints_m.shape
    position, age = np.empty((num_tracks, num_joints, 3)), np.empty((num_tracks, num_joints))
    find_newest(history_m, position, age)
    mean = np.empty(3)
    for track in range(num_tracks):
        count = 0
        mean[0] = mean[1] = mean[2] = 0.0
        for joint in range(num_joints):
            if _measured(history_m, track, joint):
                count += 1
                for axis in range(3):
                    mean[axis] += (
                        history_m[-1, track, joint, axis] - history_m[-2, track, joint, axis]
                    )
        for joint in range(num_joints):
            measured = _measured(history_m, track, joint)
            for axis in range(3):
                motion = mean[axis] / max(count, 1)
                if measured:
                    motion = history_m[-1, track, joint, axis] - history_m[-2, track, joint, axis]
                for lead in range(num_leads):
                    slots = lead + 1 + age[track, joint]
                    joints_m[lead, track, joint, axis] = (
                        position[track, joint, axis] + slots * motion
                    )


@kernel
def _known(place_m: Floats) -> bool:
    return math.isfinite(place_m[0]) and math.isfinite(place_m[1]) and math.isfinite(place_m[2])


@kernel
def _measured(history_m: Floats, track: int, joint: int) -> bool:
    """Tell whether the two newest slots show a joint."""
    if len(history_m) < 2:
        return False
    return _known(history_m[-1, track, joint]) and _known(history_m[-2, track, joint])
