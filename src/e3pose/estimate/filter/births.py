"""New tracks: pairs of unexplained detections that triangulate to one body."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.existence import DELIVERED_PRIOR, is_wide
from e3pose.estimate.filter.failed_pairs import count_failures
from e3pose.estimate.filter.leftovers import MIN_JOINTS, collect
from e3pose.estimate.filter.proportions import median_of, stature_of
from e3pose.estimate.filter.scratch import Constants, Pairs, Tracks, Waiting, Workspace
from e3pose.estimate.filter.state import APART_M, MAX_TRACKS
from e3pose.estimate.per_slot.triangulate import triangulate_person
from e3pose.model.proportions import LEAST_M, MOST_M

# tuned: m/s | not recorded | walk between views
WALK_MPS = 0.7  # all joints may have moved together so fast between two slots
# tuned: score | not recorded | score to start
SHARED_SCORE = 0.15
# tuned: px | first guess | half and twice
MAX_ERROR_PX = 10.0  # reprojection, the median over joints
# tuned: m | first guess | half and twice
MIN_EXTENT_M = 0.4  # along the longest axis of the world
# tuned: m, m | first guess | half and twice
START_JOINT_M, START_UNSEEN_M = 0.1, 0.5  # uncertainty at the start
# tuned: m/s, m/s | first guess | half and twice
START_SPEED_MPS, START_TURN_MPS = 1.0, 0.5  # of the root; of a joint beside its parent
# tuned: share | first guess | half and twice
START_EXISTENCE = 0.6


@kernel
def give_birth(
    num_tracks: int,
    num_old: int,
    time_s: float,
    dt: float,
    next_id: int,
    constants: Constants,
    workspace: Workspace,
    failed_pairs: Floats,
) -> tuple[int, int, int]:
    """Start people from pairs of leftovers; return numbers of tracks and leftovers, and `next_id`.

    The first `num_old` rows of `waiting` are of earlier slots. What still waits in the end is in
    the rows that `waiting.order` begins with.
    """
    views, tracks = workspace.views, workspace.tracks
    waiting, pairs = workspace.waiting, workspace.pairs
    num_waiting = collect(num_old, time_s, constants.wait_s, constants.core, views, waiting)
    num_pairs = _pair(num_waiting, time_s, constants, waiting, pairs)
    for index in range(num_waiting):
        pairs.taken[index] = False
    while num_tracks < MAX_TRACKS:
        best = -1  # pairs are in the order of their rows, so the first of equals is the least
        least = np.inf
        for pair in range(num_pairs):
            taken = pairs.taken[pairs.ends[pair, 0]] or pairs.taken[pairs.ends[pair, 1]]
            if pairs.fits[pair] < least and not taken:
                best, least = pair, pairs.fits[pair]
        if best < 0:
            break
        pairs.fits[best] = np.inf
        if not _is_apart(best, num_tracks, APART_M * constants.size, pairs.joints_m, tracks.state):
            continue
        first, second = waiting.order[pairs.ends[best, 0]], waiting.order[pairs.ends[best, 1]]
        moved_m = WALK_MPS * abs(waiting.times_s[first] - waiting.times_s[second])
        _start(
            num_tracks,
            next_id,
            best,
            moved_m,
            constants,
            pairs.joints_m,
            pairs.middle,
            pairs.sorted,
            tracks,
        )
        for end in range(2):
            index = pairs.ends[best, end]
            pairs.taken[index] = True
            tracks.seen_by[num_tracks, waiting.cameras[waiting.order[index]]] = True
            tracks.last_seen_s[num_tracks, waiting.cameras[waiting.order[index]]] = 0.0
        num_tracks += 1
        next_id += 1
    count_failures(num_waiting, dt, constants, views.arrived, waiting, pairs.taken, failed_pairs)
    left = 0
    for index in range(num_waiting):
        if not pairs.taken[index]:
            waiting.order[left] = waiting.order[index]
            left += 1
    return num_tracks, left, next_id


@kernel
def _pair(
    num_waiting: int,
    time_s: float,
    constants: Constants,
    waiting: Waiting,
    pairs: Pairs,
) -> int:
    """Fill `pairs` with detections that may be one person; return how many."""
    projections, scales = constants.projections, constants.scales
    num_pairs = 0
    for a in range(num_waiting):
        first = waiting.order[a]
        for b in range(a + 1, num_waiting):
            second = waiting.order[b]
            if waiting.cameras[first] == waiting.cameras[second]:
                continue
            if waiting.times_s[first] != time_s and waiting.times_s[second] != time_s:
                continue
            pairs.cameras[0], pairs.cameras[1] = waiting.cameras[first], waiting.cameras[second]
            shared = _share(
                first, second, constants.core, waiting.keypoints_px, waiting.scores, pairs
            )
            if shared < MIN_JOINTS:
                continue
            joints_m = pairs.joints_m[num_pairs]
            triangulate_person(
                pairs.rows,
                pairs.cameras,
                pairs.px,
                pairs.scores,
                projections,
                pairs.small,
                joints_m,
            )
            fit = _fit(joints_m, projections, scales, pairs.cameras, pairs.px, pairs.sorted)
            if fit < np.inf and _is_human(joints_m, constants, pairs.logs):
                pairs.fits[num_pairs] = fit
                pairs.ends[num_pairs, 0] = a
                pairs.ends[num_pairs, 1] = b
                num_pairs += 1
    return num_pairs


@kernel
def _share(
    first: int, second: int, core: Integers, keypoints_px: Floats, scores: Floats, pairs: Pairs
) -> int:
    """Copy the core joints that both detections have; return how many."""
    shared = 0
    for joint in core:
        both = scores[first, joint] > SHARED_SCORE and scores[second, joint] > SHARED_SCORE
        shared += both
        pairs.scores[0, joint] = scores[first, joint] if both else 0.0
        pairs.scores[1, joint] = scores[second, joint] if both else 0.0
        for axis in range(2):
            pairs.px[0, joint, axis] = keypoints_px[first, joint, axis] if both else 0.0
            pairs.px[1, joint, axis] = keypoints_px[second, joint, axis] if both else 0.0
    return shared


@kernel
def _fit(
    joints_m: Floats,
    projections: Floats,
    scales: Floats,
    cameras: Integers,
    px: Floats,
    sorted_px: Floats,
) -> float:
    """Return how badly two detections meet in `joints_m`; inf where they are two people's."""
    num_errors = num_good = 0
    for joint in range(len(joints_m)):
        x, y, z = joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2]
        if math.isnan(x):
            continue
        worst = 0.0
        for end in range(2):
            p = projections[cameras[end]]
            depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
            depth = depth if abs(depth) >= 1e-6 else 1e-6
            du = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / depth - px[end, joint, 0]
            dv = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / depth - px[end, joint, 1]
            error = math.sqrt(du * du + dv * dv) / scales[cameras[end]]
            worst = error if error > worst else worst
        num_good += worst < MAX_ERROR_PX
        sorted_px[num_errors] = worst
        num_errors += 1
    if num_good < MIN_JOINTS:
        return np.inf
    median = median_of(sorted_px, num_errors)
    return median / math.sqrt(num_errors) if median <= MAX_ERROR_PX else np.inf


@kernel
def _is_human(joints_m: Floats, constants: Constants, logs: Floats) -> bool:
    extent = 0.0
    for axis in range(3):
        lowest, highest = np.inf, -np.inf
        for joint in range(len(joints_m)):
            if not math.isnan(joints_m[joint, 0]):
                at = joints_m[joint, axis]
                lowest = at if at < lowest else lowest
                highest = at if at > highest else highest
        extent = highest - lowest if highest - lowest > extent else extent
    size = constants.size
    if not MIN_EXTENT_M * size <= extent <= MOST_M * size or is_wide(joints_m, constants.girdles):
        return False
    stature_m = stature_of(joints_m, constants.body, logs)
    return stature_m == 0.0 or LEAST_M <= stature_m <= MOST_M


@kernel
def _is_apart(pair: int, num_tracks: int, apart_m: float, joints_m: Floats, state: Floats) -> bool:
    for track in range(num_tracks):
        count = 0
        total = 0.0
        for joint in range(joints_m.shape[1]):
            if math.isnan(joints_m[pair, joint, 0]):
                continue
            squares = 0.0
            for axis in range(3):
                squares += (state[track, joint, axis] - joints_m[pair, joint, axis]) ** 2
            total += math.sqrt(squares)
            count += 1
        if total / count < apart_m:
            return False
    return True


@kernel
def _start(
    track: int,
    track_id: int,
    pair: int,
    moved_m: float,
    constants: Constants,
    joints_m: Floats,
    middle: Floats,
    sorted_m: Floats,
    tracks: Tracks,
) -> None:
    """Fill the row of a new track, but for the cameras that saw it."""
    num_joints, depths = joints_m.shape[1], constants.depths
    for axis in range(3):
        count = 0
        for joint in range(num_joints):
            if not math.isnan(joints_m[pair, joint, 0]):
                sorted_m[count] = joints_m[pair, joint, axis]
                count += 1
        middle[axis] = median_of(sorted_m, count)
    for joint in constants.order:
        known = not math.isnan(joints_m[pair, joint, 0])
        parent = -1 if constants.is_core[joint] else constants.parents[joint]
        spread = START_JOINT_M if known else START_UNSEEN_M
        for a in range(6):
            for b in range(6):
                tracks.covariance[track, joint, a, b] = 0.0
                tracks.shared[track, joint, a, b] = 0.0
        speed = START_SPEED_MPS**2 + depths[joint] * START_TURN_MPS**2
        for axis in range(3):
            place = middle[axis] if parent < 0 else tracks.state[track, parent, axis]
            place = joints_m[pair, joint, axis] if known else place
            tracks.state[track, joint, axis] = place
            tracks.state[track, joint, axis + 3] = 0.0
            tracks.covariance[track, joint, axis, axis] = spread**2 + moved_m**2
            tracks.covariance[track, joint, axis + 3, axis + 3] = speed
            if depths[joint] > 0:  # with the velocity of their parents, and all moved together
                tracks.shared[track, joint, axis, axis] = moved_m**2
                tracks.shared[track, joint, axis + 3, axis + 3] = speed - START_TURN_MPS**2
        tracks.unmeasured_s[track, joint] = 0.0 if known else np.inf
        tracks.drift_share[track, joint] = 1.0
    tracks.track_ids[track] = track_id
    tracks.existence[track] = START_EXISTENCE
    tracks.hits[track] = 2
    tracks.alone[track] = 0.0
    tracks.confirmed[track] = False
    tracks.mirrored[track] = 0.0
    tracks.innovations[track] = 0.0
    tracks.agility[track] = 0.0
    tracks.corrected_m[track] = 0.0
    for camera in range(tracks.seen_by.shape[1]):
        tracks.seen_by[track, camera] = False
        tracks.last_seen_s[track, camera] = np.inf
        tracks.delivered[track, camera] = DELIVERED_PRIOR
        tracks.missed[track, camera] = 0.0
        for joint in range(num_joints):
            tracks.bias_px[track, camera, joint, 0] = 0.0
            tracks.bias_px[track, camera, joint, 1] = 0.0
    for bone in range(tracks.bones_m.shape[1]):
        tracks.bones_m[track, bone] = 0.0
        tracks.bone_counts[track, bone] = 0.0
