"""An offline smoother of one person's joints, from the keypoints of all slots and views.

    least sum over slots and views of  rho(|k - pi(x)| / sigma)  +  sum over slots of  |a|^2 / q dt

with `pi` the projection, `a` the second difference of the path and `rho` growing slowly for
outliers: iterated, reweighted least squares, each pass one banded system per joint. No labels, no
causality: what calibration compares single views with, not an estimator of the loop. Arms and legs
may be held to one length each, which the path itself tells: `rigid`.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.bones import Proportions
from e3pose.estimate.filter.proportions import expected_m, median_lengths_m
from e3pose.model.projection import MIN_DEPTH_M, project
from e3pose.model.proportions import RIGID

# As the filter's: white acceleration of 7 m/s2, drawn anew every 1/25 s (`filter/motion.py`).
DENSITY_M2_PER_S3 = 7.0**2 / 25
OUTLIER_SIGMAS = 2.5
PASSES = 5
BONE_SLACK_M = 0.01  # how far a detector's limb strays from its length, over many views
TELLING_VIEWS = 2
ANCHOR_M = 1.0  # a joint that nothing sees stays about where it was believed, this loosely


def smooth(
    keypoints_px: Floats,
    sigma_px: Floats,
    projections: Floats,
    start_m: Floats,
    interval_s: float,
    passes: int = PASSES,
    rigid: Proportions | None = None,
) -> Floats:
    """Return the paths of the joints of one person.

    Args:
        keypoints_px: `(num_slots, num_cameras, num_joints, 2)` undistorted, NaN where not seen.
        sigma_px: `(num_slots, num_cameras, num_joints)` expected error; inf to leave one out.
        projections: `(num_cameras, 3, 4)`.
        start_m: `(num_slots, num_joints, 3)` where joints were roughly, all finite.
        interval_s: seconds per slot.
        passes: how often to start again from the last path.
        rigid: bones, to hold those of arms and legs to lengths that people have; as many passes
            again.

    Returns:
        `(num_slots, num_joints, 3)` metres.
    """
    path: Floats = start_m.copy()
    seen = np.isfinite(keypoints_px).all(axis=-1) & np.isfinite(sigma_px)
    variance = np.where(seen, sigma_px, 1.0) ** 2
    lengths_m: Floats | None = None
    for number in range(passes if rigid is None else 2 * passes):
        if rigid is not None and number >= passes:
            telling = seen.sum(axis=1) >= TELLING_VIEWS
            lengths_m = expected_m(rigid, *median_lengths_m(rigid, path, telling))
        pixels, depth, jacobian = (
            np.ascontiguousarray(values.swapaxes(0, 1)) for values in project(path, projections)
        )
        usable = seen & (depth > MIN_DEPTH_M)
        error = np.where(usable[..., None], keypoints_px - pixels, 0.0)
        off = (error**2).sum(axis=-1) / variance
        weight = np.where(usable, 1 / (1 + off / OUTLIER_SIGMAS**2) / variance, 0.0)
        information = np.einsum("tcj,tcjab,tcjad->tjbd", weight, jacobian, jacobian, optimize=True)
        pull = np.einsum("tcj,tcjab,tcja->tjb", weight, jacobian, error, optimize=True)
        pull += (information @ path[..., None])[..., 0] + path / ANCHOR_M**2
        if rigid is not None and lengths_m is not None:
            _hold_bones(rigid, lengths_m, path, information, pull)
        path = _solve(information, pull, interval_s)
    return path


def _hold_bones(
    body: Proportions, lengths_m: Floats, path: Floats, information: Floats, pull: Floats
) -> None:
    """Add what lengths tell of either end of arms and legs, with the other where it was."""
    for bone in np.flatnonzero((body.kinds >= 0) & (body.gives == RIGID)).tolist():
        first, second = body.bones[bone]
        between = path[:, second] - path[:, first]
        apart_m = np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-6)
        along = between / apart_m
        outer = along[:, :, None] * along[:, None, :] / BONE_SLACK_M**2
        step = (apart_m - lengths_m[bone]) / 2 * along  # half of what is too long at either end
        for joint, target in ((first, path[:, first] + step), (second, path[:, second] - step)):
            information[:, joint] += outer
            pull[:, joint] += (outer @ target[..., None])[..., 0]


def _solve(information: Floats, pull: Floats, interval_s: float) -> Floats:
    """Solve for all slots at once, joint by joint: blocks on the diagonal, two on either side."""
    from scipy.linalg import solveh_banded

    num_slots, num_joints = pull.shape[:2]
    stiffness = 1 / (DENSITY_M2_PER_S3 * interval_s**3)
    difference = np.zeros((3, num_slots))  # the squared second difference, by its diagonals
    for offset in range(max(0, num_slots - 2)):
        difference[0, offset : offset + 3] += (1, 4, 1)
        difference[1, offset : offset + 2] += (-2, -2)
        difference[2, offset] += 1
    path = np.empty_like(pull)
    for joint in range(num_joints):
        bands = np.zeros((7, num_slots, 3))  # bands[6 + i - j, j] of the matrix's (i, j), j >= i
        for row in range(3):
            for column in range(row, 3):
                bands[6 + row - column, :, column] = information[:, joint, row, column]
        bands[6] += (stiffness * difference[0] + 1 / ANCHOR_M**2)[:, None]
        bands[3, 1:] += (stiffness * difference[1, :-1])[:, None]
        bands[0, 2:] += (stiffness * difference[2, :-2])[:, None]
        flat = bands.reshape(7, 3 * num_slots)
        path[:, joint] = solveh_banded(flat, pull[:, joint].reshape(-1)).reshape(-1, 3)
    return path
