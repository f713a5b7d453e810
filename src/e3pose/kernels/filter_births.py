"""Births: the loops of `filter.births`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.filter.births import (
    APART_M,
    MAX_ERROR_PX,
    MAX_EXTENT_M,
    MAX_LEFTOVERS,
    MAX_TRACKS,
    MIN_EXTENT_M,
    MIN_JOINTS,
    REACH_M,
    SHARED_SCORE,
    START_EXISTENCE,
    START_JOINT_M,
    START_SPEED_MPS,
    START_UNSEEN_M,
    SURE_SCORE,
    WAIT_S,
)
from e3pose.filter.existence import DELIVERED_PRIOR
from e3pose.kernels.compile import kernel
from e3pose.kernels.filter_memory import Memory, Scratch, Site, Tracks, Waiting
from e3pose.kernels.place import triangulate_person

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@kernel
def give_birth(
    num_tracks: int, num_old: int, time_s: float, next_id: int, site: Site, memory: Memory
) -> tuple[int, int, int]:
    """Start people from pairs of leftovers; return numbers of tracks and leftovers, and `next_id`.

    The first `num_old` rows of `memory.waiting` are of earlier slots. What still waits in the end
    is in the rows that `memory.waiting.order` begins with.
    """
    waiting, tracks, scratch = memory.waiting, memory.tracks, memory.scratch
    num_waiting = _collect(num_old, time_s, memory)
    num_pairs = _pair(num_waiting, time_s, site, waiting, scratch)
    for index in range(num_waiting):
        scratch.taken[index] = False
    while True:
        best = -1  # pairs are in the order of their rows, so the first of equals is the least
        for pair in range(num_pairs):
            a, b = scratch.pair_ends[pair]
            if scratch.taken[a] or scratch.taken[b]:
                scratch.pair_fits[pair] = np.inf
            fit = scratch.pair_fits[pair]
            if fit < np.inf and (best < 0 or fit < scratch.pair_fits[best]):
                best = pair
        if best < 0 or num_tracks >= MAX_TRACKS:
            break
        scratch.pair_fits[best] = np.inf
        joints_m = scratch.pair_joints_m[best]
        if not _is_apart(joints_m, num_tracks, tracks):
            continue
        a, b = scratch.pair_ends[best]
        scratch.taken[a] = scratch.taken[b] = True
        _start(num_tracks, next_id, joints_m, tracks, scratch)
        tracks.seen_by[num_tracks, waiting.cameras[waiting.order[a]]] = True
        tracks.seen_by[num_tracks, waiting.cameras[waiting.order[b]]] = True
        tracks.last_seen_s[num_tracks, waiting.cameras[waiting.order[a]]] = 0.0
        tracks.last_seen_s[num_tracks, waiting.cameras[waiting.order[b]]] = 0.0
        num_tracks += 1
        next_id += 1
    left = 0
    for index in range(num_waiting):
        if not scratch.taken[index]:
            waiting.order[left] = waiting.order[index]
            left += 1
    return num_tracks, left, next_id


@kernel
def _collect(num_old: int, time_s: float, memory: Memory) -> int:
    """Add the leftovers of this slot and put all in order; return how many there are."""
    views, waiting = memory.views, memory.waiting
    num_joints = views.weights.shape[1]
    row, count = num_old, 0
    for camera in range(len(views.counts)):
        for person in range(views.counts[camera]):
            at = views.starts[camera] + person
            sure = 0
            for joint in range(num_joints):
                sure += views.weights[at, joint] > SURE_SCORE
            if not views.free[at] or sure < MIN_JOINTS or count == MAX_LEFTOVERS:
                continue
            waiting.times_s[row] = time_s
            waiting.cameras[row] = camera
            waiting.keypoints_px[row] = views.pixels[at]
            waiting.scores[row] = views.weights[at]
            waiting.order[count] = row
            row, count = row + 1, count + 1
    for old in range(num_old):
        if waiting.times_s[old] > time_s - WAIT_S and count < MAX_LEFTOVERS:
            waiting.order[count] = old
            count += 1
    for index in range(count):
        waiting.strength[waiting.order[index]] = _sum(waiting.scores[waiting.order[index]])
    for index in range(1, count):  # an insertion sort keeps equals in order
        row = waiting.order[index]
        place = index
        while place > 0 and _goes_before(row, waiting.order[place - 1], waiting):
            waiting.order[place] = waiting.order[place - 1]
            place -= 1
        waiting.order[place] = row
    return count


@kernel
def _sum(values: Floats) -> float:
    """Add as numpy does up to 128 numbers, so that equals are equal."""
    total = 0.0
    whole = len(values) - len(values) % 8 if len(values) >= 8 else 0
    if whole:
        r0, r1, r2, r3 = values[0], values[1], values[2], values[3]
        r4, r5, r6, r7 = values[4], values[5], values[6], values[7]
        for index in range(8, whole, 8):
            r0 += values[index]
            r1 += values[index + 1]
            r2 += values[index + 2]
            r3 += values[index + 3]
            r4 += values[index + 4]
            r5 += values[index + 5]
            r6 += values[index + 6]
            r7 += values[index + 7]
        total = ((r0 + r1) + (r2 + r3)) + ((r4 + r5) + (r6 + r7))
    for index in range(whole, len(values)):
        total += values[index]
    return total


@kernel
def _goes_before(row: int, other: int, waiting: Waiting) -> bool:
    if waiting.times_s[row] != waiting.times_s[other]:
        return bool(waiting.times_s[row] > waiting.times_s[other])
    if waiting.cameras[row] != waiting.cameras[other]:
        return bool(waiting.cameras[row] < waiting.cameras[other])
    return bool(waiting.strength[row] < waiting.strength[other])


@kernel
def _pair(num_waiting: int, time_s: float, site: Site, waiting: Waiting, scratch: Scratch) -> int:
    """Fill `pair_fits`, `pair_ends` and `pair_joints_m` with those who may be one person."""
    num_pairs = 0
    for a in range(num_waiting):
        first = waiting.order[a]
        for b in range(a + 1, num_waiting):
            second = waiting.order[b]
            if waiting.cameras[first] == waiting.cameras[second]:
                continue
            if waiting.times_s[first] != time_s and waiting.times_s[second] != time_s:
                continue
            fit = _meet(first, second, site, waiting, scratch, scratch.pair_joints_m[num_pairs])
            if fit < np.inf:
                scratch.pair_fits[num_pairs] = fit
                scratch.pair_ends[num_pairs, 0] = a
                scratch.pair_ends[num_pairs, 1] = b
                num_pairs += 1
    return num_pairs


@kernel
def _meet(
    first: int, second: int, site: Site, waiting: Waiting, scratch: Scratch, joints_m: Floats
) -> float:
    """Write where two detections meet to `joints_m`; return how badly, inf if they are no body."""
    num_joints = len(joints_m)
    shared = 0
    for joint in range(num_joints):
        both = (
            waiting.scores[first, joint] > SHARED_SCORE
            and waiting.scores[second, joint] > SHARED_SCORE
        )
        shared += both
        for end in range(2):
            row = first if end == 0 else second
            scratch.pair_scores[end, joint] = waiting.scores[row, joint] if both else 0.0
            for axis in range(2):
                at = waiting.keypoints_px[row, joint, axis]
                scratch.pair_px[end, joint, axis] = at if both else 0.0
    if shared < MIN_JOINTS:
        return np.inf
    scratch.pair_cameras[0] = waiting.cameras[first]
    scratch.pair_cameras[1] = waiting.cameras[second]
    triangulate_person(
        scratch.pair_rows,
        scratch.pair_cameras,
        scratch.pair_px,
        scratch.pair_scores,
        site.projections,
        scratch.small,
        joints_m,
    )
    num_errors = num_good = 0
    for joint in range(num_joints):
        if math.isnan(joints_m[joint, 0]):
            continue
        error = max(
            _error_px(joint, 0, joints_m, site, scratch),
            _error_px(joint, 1, joints_m, site, scratch),
        )
        num_good += error < MAX_ERROR_PX
        scratch.sorted[num_errors] = error
        num_errors += 1
    if num_good < MIN_JOINTS:
        return np.inf
    median = median_of(scratch.sorted, num_errors)
    if median > MAX_ERROR_PX or not _is_human(joints_m):
        return np.inf
    return median / math.sqrt(num_errors)


@kernel
def _error_px(joint: int, end: int, joints_m: Floats, site: Site, scratch: Scratch) -> float:
    """Return the reprojection error in pixels of the images that the noise was measured on."""
    camera = scratch.pair_cameras[end]
    x, y, z = joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2]
    p = site.projections
    depth = p[camera, 2, 0] * x + p[camera, 2, 1] * y + p[camera, 2, 2] * z + p[camera, 2, 3]
    depth = depth if abs(depth) >= 1e-6 else 1e-6
    squares = 0.0
    for axis in range(2):
        at = p[camera, axis, 0] * x + p[camera, axis, 1] * y
        at += p[camera, axis, 2] * z + p[camera, axis, 3]
        squares += (at / depth - scratch.pair_px[end, joint, axis]) ** 2
    return float(math.sqrt(squares) / site.scales[camera])


@kernel
def median_of(values: Floats, count: int) -> float:
    """Return the median of the first `count` values, which it puts in order."""
    for index in range(1, count):
        value = values[index]
        place = index
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    half = count // 2
    return float(values[half] if count % 2 else (values[half - 1] + values[half]) / 2)


@kernel
def _is_human(joints_m: Floats) -> bool:
    extent = 0.0
    for axis in range(3):
        lowest, highest = np.inf, -np.inf
        for joint in range(len(joints_m)):
            if not math.isnan(joints_m[joint, 0]):
                lowest = min(lowest, joints_m[joint, axis])
                highest = max(highest, joints_m[joint, axis])
        extent = max(extent, highest - lowest)
    return MIN_EXTENT_M <= extent <= MAX_EXTENT_M


@kernel
def _is_apart(joints_m: Floats, num_tracks: int, tracks: Tracks) -> bool:
    for track in range(num_tracks):
        known = 0
        total = 0.0
        for joint in range(len(joints_m)):
            if math.isnan(joints_m[joint, 0]):
                continue
            squares = 0.0
            for axis in range(3):
                squares += (tracks.state[track, joint, axis] - joints_m[joint, axis]) ** 2
            total += math.sqrt(squares)
            known += 1
        if total / known < APART_M:
            return False
    return True


@kernel
def _start(track: int, track_id: int, joints_m: Floats, tracks: Tracks, scratch: Scratch) -> None:
    """Fill the row of a new track, but for the cameras that saw it."""
    num_joints = len(joints_m)
    middle = scratch.places[0, 0]
    for axis in range(3):
        count = 0
        for joint in range(num_joints):
            if not math.isnan(joints_m[joint, 0]):
                scratch.sorted[count] = joints_m[joint, axis]
                count += 1
        middle[axis] = median_of(scratch.sorted, count)
    tracks.track_ids[track] = track_id
    tracks.covariance[track] = 0.0
    for joint in range(num_joints):
        squares = 0.0
        for axis in range(3):
            squares += (joints_m[joint, axis] - middle[axis]) ** 2
        known = math.sqrt(squares) < REACH_M  # False for NaN
        spread = START_JOINT_M if known else START_UNSEEN_M
        for axis in range(3):
            tracks.state[track, joint, axis] = joints_m[joint, axis] if known else middle[axis]
            tracks.state[track, joint, axis + 3] = 0.0
            tracks.covariance[track, joint, axis, axis] = spread**2
            tracks.covariance[track, joint, axis + 3, axis + 3] = START_SPEED_MPS**2
        tracks.unmeasured_s[track, joint] = 0.0 if known else np.inf
    tracks.existence[track] = START_EXISTENCE
    tracks.hits[track] = 2
    tracks.seen_by[track] = False
    tracks.last_seen_s[track] = np.inf
    tracks.delivered[track] = DELIVERED_PRIOR
    tracks.confirmed[track] = False
    tracks.bones_m[track] = 0.0
    tracks.bone_counts[track] = 0.0
