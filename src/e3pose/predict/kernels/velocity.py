"""Where joints were last known, and where they go on to at the pace they had."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel


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
