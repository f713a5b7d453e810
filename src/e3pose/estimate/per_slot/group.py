"""Match 2D poses across views by agglomerative clustering of ray distances.

The epipolar constraint is tested in the world: two keypoints of one joint span two rays, and the
rays of the same point pass each other closely. Its distance is in metres, so one threshold serves
near and far people and every camera. `docs/decisions/0001-matching.md` explains the choice.

Every pose begins as a group of its own. Again and again the two closest groups are merged, by the
mean ray distance over all their pairs of poses and joints (average link), unless both hold a pose
of the same view, until the closest two are further apart than `max_distance_m`. No view comes
first, so the order of views and people does not matter.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.kernel import kernel
from e3pose.estimate.per_slot.workspace import ALIVE, LABEL, NEAREST, Workspace

# So many certain joints at the distance `cap_m` are added to what two groups have in common: a
# scrap of two joints needs more than a lucky coincidence, and larger groups merge before smaller.
# tuned: joints | simulated workloads, docs/decisions/0001-matching.md: with 0 precision at five
#   views of 16 people is 0.98, with 2 recall is 0.996 | not measured
PRIOR_JOINTS = 1.0


@kernel
def group_poses(
    num_poses: int,
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Label each pose with the smallest pose index of its group.

    The sums and weights of `measure_pairs` are used up.
    """
    labels, nearest = workspace.integers[LABEL], workspace.integers[NEAREST]
    alive, distance = workspace.integers[ALIVE], workspace.distance
    num_alive = num_poses
    for pose in range(num_poses):
        labels[pose] = pose
        alive[pose] = pose
    for pose in range(num_poses):
        _find_nearest(pose, num_alive, cap_m, workspace)
    while True:
        first = -1
        smallest = np.inf
        for index in range(num_alive):
            if distance[alive[index]] < smallest:
                first = alive[index]
                smallest = distance[first]
        if first < 0 or smallest > max_distance_m:
            return
        second = nearest[first]
        first, second = min(first, second), max(first, second)
        for pose in range(num_poses):
            if labels[pose] == second:
                labels[pose] = first
        kept = 0
        for index in range(num_alive):
            if alive[index] != second:
                alive[kept] = alive[index]
                kept += 1
        num_alive = kept
        _merge(first, second, num_alive, cap_m, workspace)


@kernel
def _find_nearest(
    pose: int,
    num_alive: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    alive, nearest = workspace.integers[ALIVE], workspace.integers[NEAREST]
    sums, weights = workspace.sums, workspace.weights
    nearest[pose] = pose
    smallest = np.inf
    for index in range(num_alive):
        other = alive[index]
        link = (sums[pose, other] + PRIOR_JOINTS * cap_m) / (weights[pose, other] + PRIOR_JOINTS)
        if link < smallest:
            smallest = link
            nearest[pose] = other
    workspace.distance[pose] = smallest


@kernel
def _merge(
    first: int,
    second: int,
    num_alive: int,
    cap_m: float,
    workspace: Workspace,
) -> None:
    alive, nearest = workspace.integers[ALIVE], workspace.integers[NEAREST]
    sums, weights, distance = workspace.sums, workspace.weights, workspace.distance
    for index in range(num_alive):
        other = alive[index]
        if other == first:
            continue
        total = sums[first, other] + sums[second, other]
        weight = weights[first, other] + weights[second, other]
        sums[first, other] = sums[other, first] = total
        weights[first, other] = weights[other, first] = weight
        link = (total + PRIOR_JOINTS * cap_m) / (weight + PRIOR_JOINTS)
        if link < distance[other]:
            distance[other] = link
            nearest[other] = first
        elif nearest[other] == first or nearest[other] == second:
            _find_nearest(other, num_alive, cap_m, workspace)
    _find_nearest(first, num_alive, cap_m, workspace)
