"""Failed pairs: detections that never become a person, by their place in the image.

A poster, a mirror image, or a person whom one camera alone can see waits for a second camera in
every slot. So it is counted per camera and cell of its image how often another camera looked while
a detection waited there and no track came of it. Each look counts as the share of the first
camera's view that it overlaps, the probability with which policies expect it to start somebody.
After `SEVERAL` such looks the cell's detections no longer count as people to be met. They still
start a track as soon as two agree, which empties the cells of both.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.leftovers import SURE_SCORE
from e3pose.estimate.filter.scratch import Constants, Waiting
from e3pose.model.camera import Rig

ROWS, COLUMNS = 8, 10  # layout: cells of an image
# tuned: looks | not recorded | failed pairs
SEVERAL = 3.0  # looks that must have failed
# tuned: looks | not recorded | failed pairs
MOST = 9.0  # looks that are kept
# tuned: s | not recorded | failed pairs
FADES_S = 30.0  # until their number is down to 1/e


def nothing_known(rig: Rig) -> Floats:
    """Return `(num_cameras, ROWS, COLUMNS)` counts before the first slot."""
    return np.zeros((len(rig), ROWS, COLUMNS))


@kernel
def count_failures(
    num_waiting: int,
    dt: float,
    constants: Constants,
    arrived: Flags,
    waiting: Waiting,
    taken: Flags,
    failed_pairs: Floats,
) -> None:
    """Count this slot's looks of other cameras at waiting detections.

    Args:
        num_waiting: how many of `waiting.order` there are.
        dt: seconds since the slot before.
        constants: the rig.
        arrived: `(num_cameras,)` whose views this slot has.
        waiting: the detections, before those that started somebody are taken out.
        taken: `(num_waiting,)` which those are, in order.
        failed_pairs: of `Belief`; changed.
    """
    fading = math.exp(-dt / FADES_S)
    for camera in range(len(failed_pairs)):
        for row in range(ROWS):
            for column in range(COLUMNS):
                failed_pairs[camera, row, column] *= fading
    for index in range(num_waiting):
        if not taken[index] and _is_newest(index, waiting, taken, constants.sizes):
            at = waiting.order[index]
            camera = waiting.cameras[at]
            missed = 1.0
            for other in range(len(arrived)):
                if arrived[other]:  # a camera does not overlap itself
                    missed *= 1.0 - constants.overlap[camera, other]
            row, column = _cell(at, waiting.keypoints_px, waiting.scores, constants.sizes[camera])
            count = failed_pairs[camera, row, column] + 1.0 - missed
            failed_pairs[camera, row, column] = count if count < MOST else MOST
    for index in range(num_waiting):
        if taken[index]:
            at = waiting.order[index]
            camera = waiting.cameras[at]
            row, column = _cell(at, waiting.keypoints_px, waiting.scores, constants.sizes[camera])
            failed_pairs[camera, row, column] = 0.0


@kernel
def _is_newest(index: int, waiting: Waiting, taken: Flags, sizes: Floats) -> bool:
    """Return whether a detection is of its camera's newest look, the first one in its cell."""
    at = waiting.order[index]
    size = sizes[waiting.cameras[at]]
    cell = _cell(at, waiting.keypoints_px, waiting.scores, size)
    for earlier in range(index):  # the newest come first
        before = waiting.order[earlier]
        if waiting.cameras[before] == waiting.cameras[at]:
            if waiting.times_s[before] != waiting.times_s[at]:
                return False
            same = _cell(before, waiting.keypoints_px, waiting.scores, size) == cell
            if same and not taken[earlier]:
                return False
    return True


@kernel
def _cell(at: int, keypoints_px: Floats, scores: Floats, size: Floats) -> tuple[int, int]:
    """Return row and column of the middle of a detection's sure joints."""
    u, v, count = 0.0, 0.0, 0
    for joint in range(scores.shape[1]):
        if scores[at, joint] > SURE_SCORE:
            u += keypoints_px[at, joint, 0]
            v += keypoints_px[at, joint, 1]
            count += 1
    count = count if count else 1
    return _part(v / count / size[1], ROWS), _part(u / count / size[0], COLUMNS)


@kernel
def _part(share: float, parts: int) -> int:
    if not share > 0.0:
        return 0
    return parts - 1 if share >= 1.0 else int(share * parts)


@kernel
def count_newest(
    cameras: Integers,
    times_s: Floats,
    keypoints_px: Floats,
    scores: Floats,
    sizes: Floats,
    failed_pairs: Floats,
    unexplained: Integers,
    newest_s: Floats,
) -> None:
    """Count the detections of each camera's newest look that are worth another camera's.

    Args:
        cameras: `(num_leftovers,)` of `Leftovers`, like all up to `scores`.
        times_s: `(num_leftovers,)`.
        keypoints_px: `(num_leftovers, num_joints, 2)`.
        scores: `(num_leftovers, num_joints)`.
        sizes: `(num_cameras, 2)` of the images.
        failed_pairs: of `Belief`.
        unexplained: `(num_cameras,)` filled.
        newest_s: `(num_cameras,)` filled: when that look was; -inf where none waits.
    """
    unexplained[:] = 0
    newest_s[:] = -np.inf
    for at in range(len(cameras)):
        newest_s[cameras[at]] = max(newest_s[cameras[at]], times_s[at])
    for at in range(len(cameras)):
        camera = cameras[at]
        row, column = _cell(at, keypoints_px, scores, sizes[camera])
        if times_s[at] == newest_s[camera] and failed_pairs[camera, row, column] < SEVERAL:
            unexplained[camera] += 1
