"""Dissolve spurious groups: reassign their poses to the people they belong to.

In a crowd, poses of two people can meet by chance more closely than those of one person do. So
after grouping, weakest first, a group is dissolved if each of its poses is at home in a larger one
that has no pose of that view.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import LANES, kernel
from e3pose.estimate.per_slot.group import PRIOR_JOINTS
from e3pose.estimate.per_slot.pairs import measure_tile

# Sums of scores that differ by less are equal; then the first pose leads.
STRENGTH_UNIT = 1e-6  # numerics: of a sum of scores


@kernel
def weigh_groups(
    num_poses: int, labels: Integers, scores: Floats, sizes: Integers, strength: Floats
) -> None:
    """Fill size and strength (sum of scores, in `STRENGTH_UNIT`) of all groups; 0 where is none."""
    for pose in range(num_poses):
        sizes[pose] = 0
        strength[pose] = 0.0
    for pose in range(num_poses):
        sizes[labels[pose]] += 1
        for joint in range(scores.shape[1]):
            strength[labels[pose]] += scores[pose, joint]
    for pose in range(num_poses):
        strength[pose] = math.floor(strength[pose] / STRENGTH_UNIT + 0.5)


@kernel
def dissolve_groups(
    num_poses: int,
    cameras: Integers,
    scores: Floats,
    tiles: Floats,
    tile_centers: Floats,
    lanes: Floats,
    max_distance_m: float,
    cap_m: float,
    labels: Integers,
    sizes: Integers,
    homes: Integers,
    strength: Floats,
    group_sums: Floats,
    group_weights: Floats,
) -> None:
    """Change `labels`; `sizes` and `strength` are those of `weigh_groups` and are kept up to date.

    `homes`, `group_sums` and `group_weights` are scratch of `num_poses` each.
    """
    largest = 0
    for label in range(num_poses):
        largest = max(largest, sizes[label])
    changed = False
    weakest, last = -np.inf, -1
    while True:
        label = -1
        for other in range(num_poses):  # the next stronger group, of equals the next in order
            later = strength[other] > weakest or (strength[other] == weakest and other > last)
            later &= sizes[other] > 0
            if later and (label < 0 or strength[other] < strength[label]):
                label = other
        if label < 0:
            break
        weakest, last = strength[label], label
        if sizes[label] < 2 or sizes[label] >= largest:
            continue
        at_home = 0
        for pose in range(num_poses):
            if labels[pose] == label:
                homes[pose] = _find_home(
                    pose,
                    num_poses,
                    cameras,
                    scores.shape[1],
                    tiles,
                    tile_centers,
                    lanes,
                    max_distance_m,
                    cap_m,
                    labels,
                    sizes,
                    group_sums,
                    group_weights,
                )
                if homes[pose] < 0:
                    break
                at_home += 1
        if at_home < sizes[label]:
            continue
        changed = True
        for pose in range(num_poses):
            if labels[pose] == label:
                labels[pose] = homes[pose]
                sizes[homes[pose]] += 1
                largest = max(largest, sizes[homes[pose]])
        sizes[label] = 0
    if changed:
        weigh_groups(num_poses, labels, scores, sizes, strength)


@kernel
def _find_home(
    pose: int,
    num_poses: int,
    cameras: Integers,
    num_joints: int,
    tiles: Floats,
    tile_centers: Floats,
    lanes: Floats,
    max_distance_m: float,
    cap_m: float,
    labels: Integers,
    sizes: Integers,
    group_sums: Floats,
    group_weights: Floats,
) -> int:
    for other in range(num_poses):
        group_sums[other] = 0.0
        group_weights[other] = 0.0
    for start in range(0, num_poses, LANES):
        measure_tile(
            tiles[pose // LANES],
            tile_centers[pose // LANES],
            pose % LANES,
            tiles[start // LANES],
            tile_centers[start // LANES],
            num_joints,
            cap_m,
            lanes,
        )
        for other in range(start, min(start + LANES, num_poses)):
            if cameras[other] == cameras[pose]:
                group_sums[labels[other]] = np.inf
            else:
                group_sums[labels[other]] += lanes[3 * LANES + other - start]
                group_weights[labels[other]] += lanes[4 * LANES + other - start]
    home = -1
    smallest = max_distance_m
    for other in range(num_poses):
        if sizes[other] > sizes[labels[pose]]:
            link = (group_sums[other] + PRIOR_JOINTS * cap_m) / (
                group_weights[other] + PRIOR_JOINTS
            )
            if link <= smallest:
                home = other
                smallest = link
    return home
