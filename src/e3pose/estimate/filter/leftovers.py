"""Leftovers: unexplained detections that wait for a partner, in order (`filter.births`)."""

from __future__ import annotations

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.scratch import MAX_LEFTOVERS, Views, Waiting

# tuned: score, joints | first guess | half and twice
SURE_SCORE, MIN_JOINTS = 0.2, 8  # of a detection that may start somebody


@kernel
def collect(
    num_old: int, time_s: float, wait_s: float, core: Integers, views: Views, waiting: Waiting
) -> int:
    """Add the leftovers of this slot and sort all; return how many there are."""
    num_joints = views.weights.shape[1]
    _rank(core, views)
    rank, room = _last_rank(views)
    row, count = num_old, 0
    for camera in range(len(views.counts)):
        for at in range(views.starts[camera], views.starts[camera] + views.counts[camera]):
            if views.ranks[at] < 0 or views.ranks[at] > rank:
                continue
            if views.ranks[at] == rank:
                if room == 0:
                    continue
                room -= 1
            waiting.times_s[row] = time_s
            waiting.cameras[row] = camera
            for joint in range(num_joints):
                waiting.scores[row, joint] = views.weights[at, joint]
                waiting.keypoints_px[row, joint, 0] = views.pixels[at, joint, 0]
                waiting.keypoints_px[row, joint, 1] = views.pixels[at, joint, 1]
            waiting.order[count] = row
            row, count = row + 1, count + 1
    for old in range(num_old):
        if waiting.times_s[old] > time_s - wait_s and count < MAX_LEFTOVERS:
            waiting.order[count] = old
            count += 1
    for index in range(count):
        row = waiting.order[index]
        waiting.strength[row] = _sum(row, waiting.scores)
    for index in range(1, count):  # an insertion sort keeps equals in order
        row = waiting.order[index]
        place = index
        while place > 0 and _goes_before(
            row, waiting.order[place - 1], waiting.times_s, waiting.cameras, waiting.strength
        ):
            waiting.order[place] = waiting.order[place - 1]
            place -= 1
        waiting.order[place] = row
    return count


@kernel
def _rank(core: Integers, views: Views) -> None:
    """Fill `views.ranks`: how many of the same camera score higher; -1 if not waiting."""
    for camera in range(len(views.counts)):
        start, stop = views.starts[camera], views.starts[camera] + views.counts[camera]
        for at in range(start, stop):
            views.ranks[at] = -1
            sure = 0
            for joint in core:
                sure += views.weights[at, joint] > SURE_SCORE
            if views.free[at] and sure >= MIN_JOINTS:
                views.ranks[at] = 0
                views.strength[at] = _sum(at, views.weights)
                for other in range(start, at):
                    if views.ranks[other] < 0:
                        continue
                    if views.strength[other] >= views.strength[at]:
                        views.ranks[at] += 1
                    else:
                        views.ranks[other] += 1


@kernel
def _last_rank(views: Views) -> tuple[int, int]:
    """Return the rank up to which detections may wait, and how many of that rank."""
    rank = 0
    room = MAX_LEFTOVERS
    while rank < MAX_LEFTOVERS:
        count = 0
        for camera in range(len(views.counts)):
            for at in range(views.starts[camera], views.starts[camera] + views.counts[camera]):
                count += views.ranks[at] == rank
        if count == 0 or count >= room:
            break
        room -= count
        rank += 1
    return rank, room


@kernel
def _sum(row: int, values: Floats) -> float:
    """Sum in numpy's order for up to 128 numbers, so that ties stay ties."""
    size = values.shape[1]
    total = 0.0
    whole = size - size % 8
    if whole:
        r0, r1, r2, r3 = values[row, 0], values[row, 1], values[row, 2], values[row, 3]
        r4, r5, r6, r7 = values[row, 4], values[row, 5], values[row, 6], values[row, 7]
        for index in range(8, whole, 8):
            r0 += values[row, index]
            r1 += values[row, index + 1]
            r2 += values[row, index + 2]
            r3 += values[row, index + 3]
            r4 += values[row, index + 4]
            r5 += values[row, index + 5]
            r6 += values[row, index + 6]
            r7 += values[row, index + 7]
        total = ((r0 + r1) + (r2 + r3)) + ((r4 + r5) + (r6 + r7))
    for index in range(whole, size):
        total += values[row, index]
    return total


@kernel
def _goes_before(
    row: int, other: int, times_s: Floats, cameras: Integers, strength: Floats
) -> bool:
    if times_s[row] != times_s[other]:
        return bool(times_s[row] > times_s[other])
    if cameras[row] != cameras[other]:
        return bool(cameras[row] < cameras[other])
    return bool(strength[row] < strength[other])
