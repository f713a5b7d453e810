"""Triangulate joints seen in several views: the paper's weighted DLT, and its refinement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.triangulate import (
    MAX_STEP_M,
    MIN_DEPTH_M,
    MIN_VIEWS,
    NOISE_PX,
    NOISE_SCORES,
    OUTLIER_SIGMAS,
)


def triangulate(keypoints_px: Floats, scores: Floats, projections: Floats) -> Floats:
    """Triangulate points seen in several views by the score-weighted, row-normalised DLT.

    The paper's eq. (1) to (3): each row of A is divided by its norm and multiplied by the score.
    The norm depends on the scale of the projections and on the world's origin, as in the paper.
    """
    if len(projections) < MIN_VIEWS:
        return np.full((*scores.shape[1:], 3), np.nan)
    seen = scores > 0
    uv = np.where(seen[..., None], keypoints_px, 0.0)
    P = projections.reshape(len(uv), *(1,) * (uv.ndim - 2), 3, 4)
    rows = np.stack(
        [
            uv[..., :1] * P[..., 2, :] - P[..., 0, :],  # eq. (2)
            uv[..., 1:] * P[..., 2, :] - P[..., 1, :],
        ],
        axis=-2,
    )  # (num_views, *batch, 2, 4)
    norms = np.linalg.norm(rows, axis=-1, keepdims=True)
    weights = np.where(seen, scores, 0.0)[..., None, None] / norms  # eq. (3)
    system = np.moveaxis(weights * rows, 0, -3)  # (*batch, num_views, 2, 4)
    system = system.reshape(*system.shape[:-3], -1, 4)
    homogeneous = np.linalg.svd(system)[2][..., -1, :]  # eq. (1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        points = homogeneous[..., :3] / homogeneous[..., 3:]
        depths = _depths(points, projections)
    valid = (seen.sum(axis=0) >= MIN_VIEWS) & np.where(seen, depths > 0, True).all(axis=0)
    return np.where((valid & np.isfinite(points).all(axis=-1))[..., None], points, np.nan)


def noise_px(scores: Floats) -> Floats:
    """Return the expected error in pixels of keypoints with these scores, of the same shape."""
    return np.interp(scores, NOISE_SCORES, NOISE_PX)


def refine(
    points_m: Floats,
    keypoints_px: Floats,
    scores: Floats,
    projections: Floats,
    steps: int,
    reject_outliers: bool = False,
) -> tuple[Floats, Floats]:
    """Move points to where the reprojection errors are smallest for the noise of the detector.

    The DLT minimises an algebraic error. A few Gauss-Newton steps on the errors in pixels, each
    divided by the noise that its score promises, give the most likely point instead. Rejecting
    outliers reweights each view by 1 / (1 + r^2), r being its error in units of
    `OUTLIER_SIGMAS` standard deviations, at every step, so that a wrong view loses its say.
    """
    seen = scores > 0
    precision = np.where(seen, 1.0 / noise_px(scores), 0.0)
    best = points = points_m
    with np.errstate(all="ignore"):  # a point that runs away is not used
        tame = _far_enough(points, seen, projections)
        for _ in range(steps):
            error, jacobian = _reprojection(points, keypoints_px, projections, seen)
            weights = precision**2 * _belief(error, precision, reject_outliers)
            weighted = weights[..., None, None] * jacobian
            normal = np.einsum("v...ab,v...ac->...bc", weighted, jacobian)
            gradient = np.einsum("v...ab,v...a->...b", weighted, error)
            step = _solve3(normal, gradient)
            points = points - step
            tame &= (step**2).sum(axis=-1) <= MAX_STEP_M**2
            tame &= _far_enough(points, seen, projections)
        first_error = _reprojection(best, keypoints_px, projections, seen)[0]
        last_error = _reprojection(points, keypoints_px, projections, seen)[0]
        better = tame & (
            _loss(last_error, precision, reject_outliers)
            <= _loss(first_error, precision, reject_outliers)
        )
        best = np.where(better[..., None], points, best)
        error = _reprojection(best, keypoints_px, projections, seen)[0]
        belief = np.where(seen, _belief(error, precision, reject_outliers), 0.0)
    return best, np.nan_to_num(belief)


def reprojection_error(
    points_m: Floats, keypoints_px: Floats, scores: Floats, projections: Floats
) -> Floats:
    """Return `(*batch)`: mean distance in pixels between points and the keypoints that saw them.

    Shapes are those of `triangulate`; NaN where the point is NaN or nobody saw it.
    """
    seen = scores > 0
    error = _reprojection(points_m, keypoints_px, projections, seen)[0]
    count = seen.sum(axis=0)
    total = np.linalg.norm(error, axis=-1).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _far_enough(points: Floats, seen: NDArray[np.bool_], projections: Floats) -> NDArray[np.bool_]:
    far_enough = ~seen | (_depths(points, projections) >= MIN_DEPTH_M)
    return np.asarray(far_enough.all(axis=0))


def _depths(points: Floats, projections: Floats) -> Floats:
    """Return `(num_views, *batch)`: third homogeneous coordinate, positive in front."""
    offsets = projections[:, 2, 3].reshape(-1, *(1,) * (points.ndim - 1))
    depths: Floats = np.einsum("vc,...c->v...", projections[:, 2, :3], points) + offsets
    return depths


def _reprojection(
    points: Floats, keypoints: Floats, projections: Floats, seen: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Return errors `(num_views, *batch, 2)`, 0 where not seen, and Jacobians `(..., 2, 3)`."""
    ones = (1,) * (points.ndim - 1)
    P = projections.reshape(-1, *ones, 3, 4)
    homogeneous = np.einsum("vrc,...c->v...r", projections[:, :, :3], points) + P[..., 3]
    depth = homogeneous[..., 2:]
    pixels = homogeneous[..., :2] / depth
    error = np.where(seen[..., None], pixels - keypoints, 0.0)
    jacobian = (P[..., :2, :3] - pixels[..., None] * P[..., 2:, :3]) / depth[..., None]
    return error, np.where(seen[..., None, None], jacobian, 0.0)


def _belief(error: Floats, precision: Floats, reject_outliers: bool) -> Floats:
    if not reject_outliers:
        return np.ones_like(precision)
    squared: Floats = (error**2).sum(axis=-1)
    return 1.0 / (1.0 + squared * (precision / OUTLIER_SIGMAS) ** 2)


def _loss(error: Floats, precision: Floats, reject_outliers: bool) -> Floats:
    """Return `(*batch)`: the negative log likelihood, or an increasing function of it."""
    squares = (error**2).sum(axis=-1) * precision**2
    if reject_outliers:
        return np.asarray((1.0 + squares / OUTLIER_SIGMAS**2).prod(axis=0))
    return np.asarray(squares.sum(axis=0))


def _solve3(matrices: Floats, vectors: Floats) -> Floats:
    """Solve `(*batch, 3, 3)` systems by Cramer's rule; not finite where singular."""
    a, b, c = matrices[..., 0], matrices[..., 1], matrices[..., 2]
    bc = np.cross(b, c)
    adjugate = np.stack([bc, np.cross(c, a), np.cross(a, b)], axis=-2)
    determinant = (a * bc).sum(axis=-1, keepdims=True)
    return np.asarray((adjugate @ vectors[..., None])[..., 0] / determinant)
