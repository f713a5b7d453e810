"""From what the network says of people to all joints of their skeleton in the world."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.predict.kernels.history import close_gaps

Floats32 = NDArray[np.float32]


class Joints(NamedTuple):
    """The mapping of a skeleton's joints to the common ones."""

    columns: Integers  # (num_common, most) joints whose mean each common one is, -1 for none
    direct: Integers  # (num_common,) the joint that it is, -1 where it is none or a mean
    carried: Integers  # (num_carried,) joints that move as the nearest common one does
    sides: Integers  # (num_pairs, 2) left and right common joints


class Curves(NamedTuple):
    """The calibration of expected errors, see `attention_lstm.read_curves`."""

    x: Floats  # (num_curves, num_points) logarithms as the network states them
    y: Floats  # (num_curves, num_points) as they are found
    slopes: Floats  # (num_curves, num_points - 1)
    log_factor: Floats  # (num_factors,)


@kernel
def place_tracks(
    places: Floats32,
    log_error: Floats32,
    centre_m: Floats,
    heading: Floats,
    seen: Flags,
    newest_m: Floats,
    history_m: Floats,
    joints: Joints,
    curves: Curves,
    joints_m: Floats,
    error_m: Floats,
) -> None:
    """Fill what `AttentionLstm.predict` returns: common joints, then those carried with them.

    Args:
        places: `(num_known_leads, num_tracks, 3 * num_common)` of `run_network`.
        log_error: `(num_known_leads, num_tracks, num_common)` of `run_network`.
        centre_m: `(num_tracks, 3)`, like the next two of `history.describe`.
        heading: `(num_tracks, 2)`.
        seen: `(num_tracks, num_common)`.
        newest_m: `(num_tracks, num_common, 3)` metres in the newest slot, gaps closed.
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, NaN where missing.
        joints: of the skeleton.
        curves: of the expected errors.
        joints_m: `(num_leads, num_tracks, num_joints, 3)` metres, filled; leads beyond those of
            `places` repeat the last.
        error_m: `(num_leads, num_tracks, num_joints)` metres, filled.
    """
    num_common, num_leads = len(joints.columns), len(places)
    world, expected = np.empty((num_common, 3)), np.empty(num_common)
    others, measured = _others(history_m, joints.carried)
    for track in range(len(centre_m)):
        for lead in range(len(joints_m)):
            given = min(lead, num_leads - 1)
            _to_world(places[given, track], centre_m[track], heading[track], world)
            for joint in range(num_common):
                expected[joint] = calibrated(log_error[given, track, joint], given, curves)
                if not seen[track, joint]:
                    expected[joint] = world[joint, 0] = world[joint, 1] = world[joint, 2] = np.nan
                own = joints.direct[joint]
                if own >= 0:
                    error_m[lead, track, own] = expected[joint]
                    for axis in range(3):
                        joints_m[lead, track, own, axis] = world[joint, axis]
            for index in range(len(joints.carried)):
                joint = joints.carried[index]
                newest = others[-1, track, index]
                nearest = _nearest(newest, newest_m[track], seen[track])
                once = False
                for slot in range(len(measured)):
                    once = once or measured[slot, track, index]
                found = once and nearest >= 0
                error_m[lead, track, joint] = expected[nearest] if found else np.nan
                for axis in range(3):
                    joints_m[lead, track, joint, axis] = newest[axis] if once else np.nan
                    if found:
                        moved = world[nearest, axis] - newest_m[track, nearest, axis]
                        joints_m[lead, track, joint, axis] += moved


@kernel
def calibrated(log_error: float, lead: int, curves: Curves) -> float:
    """Return the error in metres for a network's logarithm of it at `lead`."""
    row = min(lead, len(curves.x) - 1)
    x, slopes = curves.x[row], curves.slopes[row]
    inside = min(max(log_error, x[0]), x[-1])
    total = curves.y[row, 0] + log_error - inside
    for point in range(len(slopes)):  # a piecewise linear function is a sum of clipped ramps
        total += slopes[point] * min(max(inside - x[point], 0.0), x[point + 1] - x[point])
    return math.exp(total + curves.log_factor[min(lead, len(curves.log_factor) - 1)])


@kernel
def _others(history_m: Floats, carried: Integers) -> tuple[Floats, Flags]:
    """Return the histories of the carried joints, gaps closed, and which were measured."""
    num_slots, num_tracks, _, _ = history_m.shape
    given = np.empty((num_slots, num_tracks, len(carried), 3))
    for slot in range(num_slots):
        for track in range(num_tracks):
            for index in range(len(carried)):
                for axis in range(3):
                    given[slot, track, index, axis] = history_m[slot, track, carried[index], axis]
    filled, measured = np.empty_like(given), np.empty(given.shape[:3], np.bool_)
    close_gaps(given, filled, measured)
    return filled, measured


@kernel
def _to_world(places: Floats32, centre_m: Floats, heading: Floats, world_m: Floats) -> None:
    """Fill `(num_common, 3)` of places in a person's frame, all x before all y before all z."""
    num_common = len(world_m)
    for joint in range(num_common):
        x, y = np.float64(places[joint]), np.float64(places[num_common + joint])
        world_m[joint, 0] = heading[0] * x - heading[1] * y + centre_m[0]
        world_m[joint, 1] = heading[1] * x + heading[0] * y + centre_m[1]
        world_m[joint, 2] = places[2 * num_common + joint] + centre_m[2]


@kernel
def _nearest(place_m: Floats, common_m: Floats, seen: Flags) -> int:
    """Return the common joint nearest to a place, -1 where none was seen."""
    best, least = -1, np.inf
    for joint in range(len(common_m)):
        apart = 0.0
        for axis in range(3):
            apart += (place_m[axis] - common_m[joint, axis]) ** 2
        if seen[joint] and apart < least:
            best, least = joint, apart
    return best
