"""Match 2D poses across views: which poses of different cameras show the same person.

The epipolar constraint is tested in the world: two keypoints of one joint span two rays, and the
rays of the same point pass each other closely. Its distance is in metres, so one threshold serves
near and far people and every camera; the first decision of the docs explains the choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.fuse import PRIOR_JOINTS, STRENGTH_UNIT
from e3pose.estimate.per_slot.pairs import PARALLEL_SINE2


def ray_distances(
    rays: Floats, centers_m: Floats, scores: Floats, cap_m: float
) -> tuple[Floats, Floats]:
    """Measure how closely the rays of all pairs of poses pass each other.

    Args:
        rays: `(num_poses, num_joints, 3)` unit world directions; anything where not seen.
        centers_m: `(num_poses, 3)` optical centre of the camera that saw the pose.
        scores: `(num_poses, num_joints)` in [0, 1]; 0 where not seen.
        cap_m: the most that one joint may count, so that one wild keypoint does not decide; also
            what a joint counts whose rays are closest behind a camera.

    Returns:
        `(num_poses, num_poses)` weighted sums of the distances over the joints, in metres, and the
        sums of the weights. A joint weighs the lower of its two scores.
    """
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

    Args:
        rays: `(num_poses, num_joints, 3)` unit world directions; anything where not seen.
        centers_m: `(num_poses, 3)` optical centre of the camera that saw the pose.
        scores: `(num_poses, num_joints)` in [0, 1]; 0 where not seen.
        cameras: `(num_poses,)` camera index of each pose.
        max_distance_m: the largest mean distance at which two groups are one person.
        cap_m: the most that one joint may count.

    Returns:
        Groups of pose indices, strongest (sum of all scores) first; a person seen once is a group
        of one.
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


def match_epipolar(
    keypoints_px: Floats,
    scores: Floats,
    cameras: NDArray[np.int64],
    projections: Floats,
    max_distance_px: float,
) -> list[list[int]]:
    """Group poses by person greedily, camera by camera.

    Args:
        keypoints_px: `(num_poses, num_joints, 2)` undistorted pixels; anything where not seen.
        scores: `(num_poses, num_joints)` in [0, 1]; 0 where not seen.
        cameras: `(num_poses,)` camera index of each pose, in rising order.
        projections: `(num_cameras, 3, 4)`.
        max_distance_px: the most that a pose may cost the candidate it is assigned to.

    Returns:
        Groups of pose indices, strongest (sum of all scores) first.
    """
    candidates: list[list[int]] = []
    for camera in np.unique(cameras):
        poses = np.flatnonzero(cameras == camera).tolist()
        costs = np.full((len(candidates), len(poses)), np.inf)
        for row, members in enumerate(candidates):
            for column, pose in enumerate(poses):
                apart = [
                    _epipolar_px(keypoints_px[[m, pose]], scores[[m, pose]], projections[pair])
                    for m in members
                    for pair in [[cameras[m], camera]]
                ]
                known = [distance for distance in apart if np.isfinite(distance)]
                costs[row, column] = np.mean(known) if known else np.inf
        left = set(poses)
        while costs.size and costs.min() < max_distance_px:
            row, column = divmod(int(np.argmin(costs)), len(poses))
            candidates[row].append(poses[column])
            left.remove(poses[column])
            costs[row], costs[:, column] = np.inf, np.inf
        candidates += [[pose] for pose in sorted(left)]
    return _strongest_first(candidates, scores)


def match_tanke_gall(
    keypoints_px: Floats,
    scores: Floats,
    cameras: NDArray[np.int64],
    projections: Floats,
    max_distance_px: float,
) -> list[list[int]]:
    """Group poses by person as Tanke and Gall (2019) do. Arguments are those of `match_epipolar`.

    A pose of a mean score up to 0.3 is a group of its own.
    """
    seen = scores > 0
    believed = np.where(seen, scores, 0.0).sum(axis=-1) / np.maximum(seen.sum(axis=-1), 1)
    candidates: list[list[int]] = []
    for camera in np.unique(cameras):
        poses = [p for p in np.flatnonzero(cameras == camera).tolist() if believed[p] > 0.3]
        apart = [
            [
                [
                    _epipolar_px(
                        keypoints_px[[m, pose]],
                        scores[[m, pose]],
                        projections[[cameras[m], camera]],
                    )
                    for m in members
                ]
                for pose in poses
            ]
            for members in candidates
        ]
        costs = np.array(
            [
                [np.mean([d for d in row if np.isfinite(d)] or [1e6]) for row in rows]
                for rows in apart
            ]
        ).reshape(len(candidates), len(poses))
        left = set(poses)
        pairs = list(zip(*linear_sum_assignment(np.minimum(costs, 1e6)), strict=True))
        for row, column in pairs:
            far = [not d <= max_distance_px for d in apart[row][column]]
            strong = believed[candidates[row]] > 0.5
            if not (np.array(far) & strong).any():
                candidates[row].append(poses[column])
                left.remove(poses[column])
        candidates += [[pose] for pose in sorted(left)]
    candidates += [[pose] for pose in np.flatnonzero(believed <= 0.3).tolist()]
    return _strongest_first(candidates, scores)


def _strongest_first(candidates: list[list[int]], scores: Floats) -> list[list[int]]:
    strength = scores.sum(axis=-1)
    order = sorted(
        range(len(candidates)), key=lambda i: (-_units(strength[candidates[i]]), candidates[i][0])
    )
    return [candidates[label] for label in order]


def _epipolar_px(keypoints_px: Floats, scores: Floats, projections: Floats) -> float:
    """Return the mean distance of two poses from each other's epipolar lines; infinite if none.

    An epipolar line is found without a fundamental matrix: as the image of two points on a ray.
    """
    shared = (scores > 0).all(axis=0)
    if not shared.any():
        return np.inf
    total = 0.0
    for own, other in ((0, 1), (1, 0)):
        P, Q = projections[own], projections[other]
        center = np.append(-np.linalg.solve(P[:, :3], P[:, 3]), 1.0)
        pixels = np.concatenate([keypoints_px[own], np.ones((len(scores[0]), 1))], axis=-1)
        rays = np.linalg.solve(P[:, :3], pixels.T).T
        far = np.concatenate([rays, np.zeros((len(rays), 1))], axis=-1)
        lines = np.cross(Q @ center, far @ Q.T)
        points = np.concatenate([keypoints_px[other], np.ones((len(rays), 1))], axis=-1)
        distance = np.abs((lines * points).sum(axis=-1)) / np.hypot(lines[:, 0], lines[:, 1])
        total += float(distance[shared].mean()) / 2
    return total
