"""Histories as the network takes them: common joints, gaps closed, place and heading taken out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel

Floats32 = NDArray[np.float32]

FAR_M = 1e4  # from the origin of the world; beyond it a position is taken for a mistake
ROUGH_FLOOR_M = 1e-4  # a slot; rougher than this is noise or motion
SPEED_FLOOR_M = 5e-4  # a slot; slower than this is standing still
SPEED_CEILING_M = 2.0  # a slot; faster is a mistake of the tracker
SHORTEST_S, LONGEST_S = 1 / 60, 1 / 5  # slots that were learned; others count as the nearest
LEAST_WIDTH_M = 1e-3  # across hips and shoulders; narrower people face nowhere


@kernel
def common_joints(joints_m: Floats, columns: Integers, common_m: Floats) -> None:
    """Fill `(num_poses, num_common, 3)` with the means of the `columns` of `joints_m`.

    Args:
        joints_m: `(num_poses, num_joints, 3)` metres, NaN where missing.
        columns: `(num_common, most)` of `joints_m`, -1 for no more; a common joint without any, or
            with a missing one, is missing.
        common_m: filled.
    """
    for pose in range(len(joints_m)):
        for joint in range(len(columns)):
            count = 0
            for axis in range(3):
                common_m[pose, joint, axis] = 0.0
            for column in columns[joint]:
                if column >= 0:
                    count += 1
                    for axis in range(3):
                        common_m[pose, joint, axis] += joints_m[pose, column, axis]
            for axis in range(3):
                common_m[pose, joint, axis] /= count  # 0 / 0 is NaN


@kernel
def close_gaps(history_m: Floats, filled_m: Floats, measured: Flags) -> None:
    """Close gaps: a missing joint moves with its person, evenly between its neighbours.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, NaN where missing.
        filled_m: of the same shape, filled; 0 for joints that the history never shows.
        measured: `(num_slots, num_tracks, num_joints)`, filled.
    """
    num_slots, num_tracks, num_joints = measured.shape
    path = np.zeros((num_slots, 3))
    for track in range(num_tracks):
        if _find_measured(history_m, track, measured):
            for slot in range(num_slots):
                for joint in range(num_joints):
                    for axis in range(3):
                        filled_m[slot, track, joint, axis] = history_m[slot, track, joint, axis]
            continue
        _walk(history_m[:, track], measured[:, track], path)
        for joint in range(num_joints):
            before = -1
            for slot in range(num_slots):
                for axis in range(3):
                    filled_m[slot, track, joint, axis] = 0.0
                if measured[slot, track, joint]:
                    for axis in range(3):
                        filled_m[slot, track, joint, axis] = history_m[slot, track, joint, axis]
                    _bridge(
                        history_m[:, track, joint], path, before, slot, filled_m[:, track, joint]
                    )
                    before = slot
            if before >= 0:
                _bridge(
                    history_m[:, track, joint], path, before, num_slots, filled_m[:, track, joint]
                )


@kernel
def _find_measured(history_m: Floats, track: int, measured: Flags) -> bool:
    """Mark the joints of a person that are no mistakes; return whether that is all of them."""
    everything = True
    for slot in range(measured.shape[0]):
        for joint in range(measured.shape[2]):
            near = True
            for axis in range(3):
                near &= abs(history_m[slot, track, joint, axis]) < FAR_M
            measured[slot, track, joint] = near
            everything &= near
    return everything


@kernel
def _walk(history_m: Floats, measured: Flags, path: Floats) -> None:
    """Fill `path` `(num_slots, 3)`: how far a person went since the first slot.

    Each slot adds the mean motion of the joints that were measured before and after.
    """
    for slot in range(1, len(path)):
        count = 0
        for axis in range(3):
            path[slot, axis] = 0.0
        for joint in range(measured.shape[1]):
            if measured[slot, joint] and measured[slot - 1, joint]:
                count += 1
                for axis in range(3):
                    path[slot, axis] += history_m[slot, joint, axis]
                    path[slot, axis] -= history_m[slot - 1, joint, axis]
        for axis in range(3):
            path[slot, axis] = path[slot - 1, axis] + path[slot, axis] / max(count, 1)


@kernel
def _bridge(joint_m: Floats, path: Floats, before: int, after: int, filled_m: Floats) -> None:
    """Fill the slots between two in which a joint was measured; -1 and the length for none."""
    first = before if before >= 0 else after
    last = after if after < len(path) else first
    for slot in range(before + 1, min(after, len(path))):
        share = (slot - first) / (last - first) if last > first else 0.0
        for axis in range(3):
            start = joint_m[first, axis] - path[first, axis]
            end = joint_m[last, axis] - path[last, axis]
            filled_m[slot, axis] = start + share * (end - start) + path[slot, axis]


@kernel
def describe(
    filled_m: Floats,
    measured: Flags,
    intervals_s: Floats,
    sides: Integers,
    features: Floats32,
    context: Floats32,
    centre_m: Floats,
    heading: Floats,
    speed_m: Floats,
    seen: Flags,
) -> None:
    """Fill the network's input, each person in a frame of their own.

    Args:
        filled_m: `(num_slots, num_tracks, num_common, 3)`, gaps closed.
        measured: `(num_slots, num_tracks, num_common)`.
        intervals_s: `(num_tracks,)` seconds per slot.
        sides: `(num_pairs, 2)` left and right joints that tell which way a person faces.
        features: `(num_slots, num_tracks, 7 * num_common)`, filled like all that follow.
        context: `(num_tracks, 4)`.
        centre_m: `(num_tracks, 3)` origin of the person's frame in the world.
        heading: `(num_tracks, 2)` unit vector in the floor plane from right to left.
        speed_m: `(num_tracks,)` root mean square motion of a joint per slot.
        seen: `(num_tracks, num_common)` joints that the history shows in any slot.
    """
    num_slots, num_tracks, num_joints = measured.shape
    turned, motion = np.empty((num_slots, num_joints, 3)), np.zeros((num_slots, num_joints, 3))
    for track in range(num_tracks):
        count = 0
        for joint in range(num_joints):
            seen[track, joint] = False
            for slot in range(num_slots):
                seen[track, joint] = seen[track, joint] or measured[slot, track, joint]
            count += seen[track, joint]
        weight = 1.0 / max(count, 1)
        for axis in range(3):
            centre_m[track, axis] = 0.0
            for joint in range(num_joints):
                if seen[track, joint]:
                    centre_m[track, axis] += weight * filled_m[-1, track, joint, axis]
        _face(filled_m[-1, track], seen[track], sides, heading[track])
        _turn(filled_m[:, track], seen[track], centre_m[track], heading[track], turned)
        squares, bends = 0.0, 0.0
        for slot in range(1, num_slots):
            for joint in range(num_joints):
                if seen[track, joint]:
                    for axis in range(3):
                        step = turned[slot, joint, axis] - turned[slot - 1, joint, axis]
                        bend = step - motion[slot - 1, joint, axis]
                        motion[slot, joint, axis] = step
                        squares += weight * step * step
                        bends += weight * bend * bend if slot > 1 else 0.0
                else:
                    for axis in range(3):
                        motion[slot, joint, axis] = 0.0
        speed = math.sqrt(squares / (num_slots - 1) + SPEED_FLOOR_M**2)
        speed_m[track] = speed = min(speed, SPEED_CEILING_M)
        rough = bends / (num_slots - 2)
        for slot in range(num_slots):
            for joint in range(num_joints):
                for axis in range(3):
                    place = axis * num_joints + joint
                    features[slot, track, place] = turned[slot, joint, axis]
                    pace = motion[slot, joint, axis] / speed if slot else 0.0
                    features[slot, track, place + 3 * num_joints] = pace
                features[slot, track, 6 * num_joints + joint] = measured[slot, track, joint]
        interval_s = min(max(intervals_s[track], SHORTEST_S), LONGEST_S)
        context[track, 0] = math.log(speed / 0.01)
        context[track, 1] = math.log(interval_s * 30)
        context[track, 2] = math.sqrt(rough) / speed
        context[track, 3] = 0.5 * math.log(rough / 0.01**2 + (ROUGH_FLOOR_M / 0.01) ** 2)


@kernel
def _face(newest_m: Floats, seen: Flags, sides: Integers, heading: Floats) -> None:
    """Fill the direction to the left of a person, (1, 0) for one who faces nowhere."""
    x, y = 0.0, 0.0
    for pair in range(len(sides)):
        left, right = sides[pair, 0], sides[pair, 1]
        if seen[left] and seen[right]:
            x += newest_m[left, 0] - newest_m[right, 0]
            y += newest_m[left, 1] - newest_m[right, 1]
    length = math.hypot(x, y)
    wide = length > LEAST_WIDTH_M
    heading[0] = x / length if wide else 1.0
    heading[1] = y / length if wide else 0.0


@kernel
def _turn(filled_m: Floats, seen: Flags, centre_m: Floats, heading: Floats, turned: Floats) -> None:
    """Fill `turned` `(num_slots, num_joints, 3)`: a history in the person's own frame."""
    cosine, sine = heading[0], heading[1]
    for slot in range(len(turned)):
        for joint in range(turned.shape[1]):
            for axis in range(3):
                turned[slot, joint, axis] = 0.0
            if seen[joint]:
                x = filled_m[slot, joint, 0] - centre_m[0]
                y = filled_m[slot, joint, 1] - centre_m[1]
                turned[slot, joint, 0] = cosine * x + sine * y
                turned[slot, joint, 1] = cosine * y - sine * x
                turned[slot, joint, 2] = filled_m[slot, joint, 2] - centre_m[2]
