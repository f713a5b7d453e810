"""Dissolve spurious groups: reassign their poses to the people they belong to.

In a crowd, poses of two people can meet by chance more closely than those of one person do. So
after grouping, weakest first, a group is dissolved if each of its poses is at home in a larger one
that has no pose of that view.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.kernel import LANES, kernel
from e3pose.estimate.per_slot.group import PRIOR_JOINTS
from e3pose.estimate.per_slot.pairs import measure_tile
from e3pose.estimate.per_slot.workspace import CAMERA, LABEL, NEAREST, SIZE, Workspace

# Sums of scores that differ by less are equal; then the first pose leads.
STRENGTH_UNIT = 1e-6  # numerics: of a sum of scores


@kernel
def weigh_groups(num_poses: int, workspace: Workspace) -> None:
    """Fill size and strength (sum of scores, in `STRENGTH_UNIT`) of all groups; 0 where is none."""
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    scores, strength = workspace.scores, workspace.strength
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
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> None:
    """Change the labels; keep sizes and strengths (see `weigh_groups`) up to date.

    What `measure_pairs` and `group_poses` worked in is used up.
    """
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    homes, strength = workspace.integers[NEAREST], workspace.strength
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
                homes[pose] = _find_home(pose, num_poses, max_distance_m, cap_m, workspace)
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
        weigh_groups(num_poses, workspace)


@kernel
def _find_home(
    pose: int,
    num_poses: int,
    max_distance_m: float,
    cap_m: float,
    workspace: Workspace,
) -> int:
    """Return the group in which a pose is at home; -1 for none."""
    cameras, lanes = workspace.integers[CAMERA], workspace.lanes
    labels, sizes = workspace.integers[LABEL], workspace.integers[SIZE]
    group_sums, group_weights = workspace.distance, workspace.weights[0]
    for other in range(num_poses):
        group_sums[other] = 0.0
        group_weights[other] = 0.0
    for start in range(0, num_poses, LANES):
        measure_tile(pose, start // LANES, cap_m, workspace)
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
