"""Match 2D poses across views: which poses of different cameras show the same person.

The epipolar constraint is tested in the world: two keypoints of one joint span two rays, and the
rays of the same point pass each other closely. Its distance is in metres, so one threshold serves
near and far people and every camera; the first decision of the docs explains the choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.fuse import PRIOR_JOINTS, STRENGTH_UNIT
from e3pose.estimate.per_slot.pairs import PARALLEL_SINE2


def ray_distances(
    rays: Floats, centers_m: Floats, scores: Floats, cap_m: float
) -> tuple[Floats, Floats]:
    """Measure how closely the rays of all pairs of poses pass each other."""
    rays = np.where((scores > 0)[..., None], rays, 0.0)
    baseline = (centers_m[None, :] - centers_m[:, None])[:, :, None, :]
    normal = np.cross(rays[:, None], rays[None, :])  # (num_poses, num_poses, num_joints, 3)
    sine2 = (normal**2).sum(axis=-1)
    cosine = (rays[:, None] * rays[None, :]).sum(axis=-1)
    along_first = (baseline * rays[:, None]).sum(axis=-1)
    along_second = (baseline * rays[None, :]).sum(axis=-1)
    crossing = sine2 > PARALLEL_SINE2
    distance = np.abs((baseline * normal).sum(axis=-1)) / np.sqrt(np.where(crossing, sine2, 1.0))
    in_front = (along_first > cosine * along_second) & (cosine * along_first > along_second)
    distance = np.where(in_front, np.minimum(distance, cap_m), cap_m)
    weights = np.where(crossing, np.minimum(scores[:, None], scores[None, :]), 0.0)
    return (weights * distance).sum(axis=-1), weights.sum(axis=-1)


def match(
    rays: Floats,
    centers_m: Floats,
    scores: Floats,
    cameras: NDArray[np.int64],
    max_distance_m: float,
    cap_m: float,
) -> list[list[int]]:
    """Group the poses of all views by person, greedily and closest first.

    Every pose begins as a group of its own. Again and again the two closest groups are merged, by
    the mean ray distance over all their pairs of poses and joints (average link), unless both hold
    a pose of the same view, until the closest two are further apart than `max_distance_m`. No view
    comes first, so the order of views and people does not matter.

    In a crowd, poses of two people can meet by chance more closely than those of one person do. So
    in the end, weakest first, a group is dissolved if each of its poses is at home in a larger one
    that has no pose of that view.
    """
    if len(cameras) == 0:
        return []
    sums, weights = ray_distances(rays, centers_m, scores, cap_m)
    sums[cameras[:, None] == cameras[None, :]] = np.inf
    pair_sums, pair_weights = sums.copy(), weights.copy()
    groups = [[pose] for pose in range(len(cameras))]
    links = _links(sums, weights, cap_m)
    while True:
        first, second = divmod(int(np.argmin(links)), len(cameras))
        if not links[first, second] <= max_distance_m:
            break
        groups[first] += groups[second]
        groups[second] = []
        for total in (sums, weights):
            total[first] += total[second]
            total[:, first] = total[first]
        sums[second] = sums[:, second] = np.inf
        links = _links(sums, weights, cap_m)
    strength = scores.sum(axis=-1)
    for label in sorted(range(len(groups)), key=lambda i: (_units(strength[groups[i]]), i)):
        group = groups[label]
        homes = [
            _home(pose, len(group), groups, pair_sums, pair_weights, max_distance_m, cap_m)
            for pose in group
        ]
        if len(group) > 1 and None not in homes:
            for pose, home in zip(group, homes, strict=True):
                if home is not None:
                    home.append(pose)
            group.clear()
    order = sorted(range(len(groups)), key=lambda i: (-_units(strength[groups[i]]), i))
    return [groups[label] for label in order if groups[label]]


def _units(strength: Floats) -> int:
    """Return the sum in whole units, so that equal groups are not ordered by rounding errors."""
    return int(np.floor(strength.sum() / STRENGTH_UNIT + 0.5))


def _home(
    pose: int,
    size: int,
    groups: list[list[int]],
    pair_sums: Floats,
    pair_weights: Floats,
    max_distance_m: float,
    cap_m: float,
) -> list[int] | None:
    """Return the closest group of more than `size` poses that `pose` could join, if any."""
    best, smallest = None, max_distance_m
    for group in groups:
        if len(group) > size:
            link = _links(pair_sums[pose, group].sum(), pair_weights[pose, group].sum(), cap_m)
            if link <= smallest:
                best, smallest = group, float(link)
    return best


def _links(sums: Floats, weights: Floats, cap_m: float) -> Floats:
    return np.asarray((sums + PRIOR_JOINTS * cap_m) / (weights + PRIOR_JOINTS))
