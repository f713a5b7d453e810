"""Sparse least squares of bundle adjustment: cameras against many small blocks.

Every residual belongs to one camera and one block (a point, or a board at one time). Blocks do not
touch each other, so they are eliminated and the normal equations shrink to the cameras: the Schur
complement of Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment - a modern synthesis"
(2000), section 6.1. Outliers are reweighted at each step (their section 3.3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats

State = TypeVar("State")

MAX_STEPS = 60
FIRST_DAMPING = 1e-3
MOST_DAMPING = 1e10
SMALL_GAIN = 1e-7  # relative; a step that lowers the cost by less ends the search


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Residuals and their derivatives at one state.

    Attributes:
        residuals: `(num_cameras, num_blocks, num_points, 2)` in standard deviations; 0 where
            nothing was seen.
        by_camera: `(num_cameras, num_blocks, num_points, 2, p)` derivatives by the camera.
        by_block: `(num_cameras, num_blocks, num_points, 2, d)` derivatives by the block.
    """

    residuals: Floats
    by_camera: Floats
    by_block: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Generic[State]):
    """Where the search ended.

    Attributes:
        state: the best state.
        cost: half the sum of the robust squares there.
        weights: `(num_cameras, num_blocks, num_points)` how much each observation counted, in
            [0, 1].
        camera_covariance: `(num_cameras, p, num_cameras, p)` of the camera parameters for residuals
            of one standard deviation, with the held parameters at 0.
        steps: steps taken.
    """

    state: State
    cost: float
    weights: Floats
    camera_covariance: Floats
    steps: int


def solve(
    state: State,
    linearise: Callable[[State], Linearised],
    retract: Callable[[State, Floats, Floats], State],
    free: NDArray[np.bool_],
    prior: Callable[[State], tuple[Floats, Floats]],
    outlier_sigmas: float,
    max_steps: int = MAX_STEPS,
) -> Solution[State]:
    """Minimise by Levenberg and Marquardt's method.

    Args:
        state: where to begin.
        linearise: residuals and derivatives at a state.
        retract: moves a state by `(num_cameras, p)` and `(num_blocks, d)`.
        free: `(num_cameras, p)` which camera parameters may change.
        prior: at a state, `(num_cameras, p)` distances from what is expected, and the inverse
            `(num_cameras * p, num_cameras * p)` of their covariance; 0 for what is not expected.
        outlier_sigmas: residual at which Cauchy's loss halves the weight; infinite for none.
        max_steps: at most so many steps.
    """
    system = linearise(state)
    cost = _cost(system.residuals, prior(state), outlier_sigmas)
    damping, steps = FIRST_DAMPING, 0
    while steps < max_steps and damping < MOST_DAMPING:
        steps += 1
        parts = _normal_parts(system, prior(state), outlier_sigmas)
        while damping < MOST_DAMPING:
            by_camera, by_block = _step(parts, free, damping)
            trial = retract(state, by_camera, by_block)
            trial_system = linearise(trial)
            trial_cost = _cost(trial_system.residuals, prior(trial), outlier_sigmas)
            if trial_cost <= cost:  # NaN is refused
                break
            damping *= 5
        else:
            break
        gain = cost - trial_cost
        state, system, cost = trial, trial_system, trial_cost
        damping = max(damping / 5, 1e-12)
        if gain <= SMALL_GAIN * cost:
            break
    parts = _normal_parts(system, prior(state), outlier_sigmas)
    return Solution(
        state, cost, weights_of(system.residuals, outlier_sigmas), _covariance(parts, free), steps
    )


def reduced_normal(system: Linearised, outlier_sigmas: float) -> tuple[Floats, Floats]:
    """Return the normal equations of the cameras alone, without any prior.

    Args:
        system: residuals at one state; every block is seen well enough to be placed.
        outlier_sigmas: as `solve` has it.

    Returns:
        `(num_cameras * p, num_cameras * p)` matrix and `(num_cameras * p,)` gradient.
    """
    num_cameras, p = system.by_camera.shape[0], system.by_camera.shape[-1]
    nothing = np.zeros((num_cameras, p)), np.zeros((num_cameras * p, num_cameras * p))
    parts = _normal_parts(system, nothing, outlier_sigmas)
    # Without the floor of `_inverses`: it would hold the scale, which is free.
    reduced, folded = _reduced(parts, np.asarray(np.linalg.inv(parts.blocks)))
    gradient = parts.camera_gradient.reshape(-1) - folded @ parts.block_gradient.reshape(-1)
    return reduced, gradient


def curvature_share(residuals: Floats, outlier_sigmas: float) -> float:
    """Return the mean ratio of the true curvature of Cauchy's loss to that of its weights (IRLS).

    Args:
        residuals: `(*batch, 2)`; 0 where nothing was seen.
        outlier_sigmas: as `solve` has it.
    """
    squares = (residuals**2).sum(axis=-1)
    weights = weights_of(residuals, outlier_sigmas)[squares > 0]
    lost = weights**2 * squares[squares > 0] / outlier_sigmas**2
    return max(1 - float(lost.sum() / weights.sum()), 0.1)


def weights_of(residuals: Floats, outlier_sigmas: float) -> Floats:
    """Return Cauchy's weights `1 / (1 + (e / c)^2)` of `(*batch, 2)` residuals."""
    return np.asarray(1.0 / (1.0 + (residuals**2).sum(axis=-1) / outlier_sigmas**2))


def _cost(residuals: Floats, prior: tuple[Floats, Floats], outlier_sigmas: float) -> float:
    squares = (residuals**2).sum(axis=-1)
    distances, precision = prior
    expected = float(distances.reshape(-1) @ precision @ distances.reshape(-1))
    if np.isinf(outlier_sigmas):
        return 0.5 * (float(squares.sum()) + expected)
    robust = outlier_sigmas**2 * np.log1p(squares / outlier_sigmas**2)
    return 0.5 * (float(robust.sum()) + expected)


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """Blocks of the normal equations."""

    cameras: Floats  # (num_cameras, p, p)
    expected: Floats  # (num_cameras * p, num_cameras * p) of the prior
    blocks: Floats  # (num_blocks, d, d)
    mixed: Floats  # (num_cameras, num_blocks, p, d)
    camera_gradient: Floats  # (num_cameras, p)
    block_gradient: Floats  # (num_blocks, d)


def _normal_parts(
    system: Linearised, prior: tuple[Floats, Floats], outlier_sigmas: float
) -> _Parts:
    num_cameras, num_blocks = system.residuals.shape[:2]
    p, d = system.by_camera.shape[-1], system.by_block.shape[-1]
    root = np.sqrt(weights_of(system.residuals, outlier_sigmas))[..., None]
    r = root * system.residuals
    A = (root[..., None] * system.by_camera).reshape(num_cameras, num_blocks, -1, p)
    B = (root[..., None] * system.by_block).reshape(num_cameras, num_blocks, -1, d)
    # One product for all that a camera sees, and one for all that see a block, are few and large.
    of_camera = A.reshape(num_cameras, -1, p)
    of_block = np.swapaxes(B, 0, 1).reshape(num_blocks, -1, d)
    r_of_block = np.swapaxes(r, 0, 1).reshape(num_blocks, -1, 1)
    distances, precision = prior
    return _Parts(
        np.swapaxes(of_camera, -1, -2) @ of_camera,
        precision,
        np.swapaxes(of_block, -1, -2) @ of_block,
        np.swapaxes(A, -1, -2) @ B,
        (r.reshape(num_cameras, 1, -1) @ of_camera)[:, 0]
        + (precision @ distances.reshape(-1)).reshape(num_cameras, p),
        (np.swapaxes(of_block, -1, -2) @ r_of_block)[..., 0],
    )


def _step(parts: _Parts, free: NDArray[np.bool_], damping: float) -> tuple[Floats, Floats]:
    inverses = _inverses(parts.blocks, damping)
    reduced, folded = _reduced(parts, inverses)
    num_cameras, p = parts.camera_gradient.shape
    scale = np.einsum("cpp->cp", parts.cameras).reshape(-1) + np.diag(parts.expected)
    reduced[np.diag_indices_from(reduced)] += damping * np.maximum(scale, 1e-12)
    gradient = parts.camera_gradient.reshape(-1) - folded @ parts.block_gradient.reshape(-1)
    chosen = free.reshape(-1)
    by_camera = np.zeros(num_cameras * p)
    if chosen.any():
        by_camera[chosen] = -np.linalg.lstsq(
            reduced[np.ix_(chosen, chosen)], gradient[chosen], rcond=1e-14
        )[0]
    moved = by_camera.reshape(num_cameras, p)
    right = parts.block_gradient + (moved[:, None, None] @ parts.mixed)[:, :, 0].sum(axis=0)
    by_block = -(inverses @ right[..., None])[..., 0]
    return moved, np.asarray(by_block)


def _inverses(blocks: Floats, damping: float) -> Floats:
    """Invert `(num_blocks, d, d)`, each damped; a block that nothing saw stays where it is."""
    d = blocks.shape[-1]
    diagonal = np.einsum("fdd->fd", blocks)
    damped = np.array(blocks)
    floor = 1e-9 * diagonal.max(axis=-1, keepdims=True) + 1e-30
    damped[:, np.arange(d), np.arange(d)] += damping * diagonal + floor
    return np.asarray(np.linalg.inv(damped))


def _reduced(parts: _Parts, inverses: Floats) -> tuple[Floats, Floats]:
    """Return the Schur complement on the cameras, and what folds a block gradient into it."""
    num_cameras, num_blocks, p, d = parts.mixed.shape
    folded = np.moveaxis(parts.mixed @ inverses, 2, 1).reshape(num_cameras * p, num_blocks * d)
    mixed = np.moveaxis(parts.mixed, 2, 1).reshape(num_cameras * p, num_blocks * d)
    reduced = parts.expected - folded @ mixed.T
    for camera in range(num_cameras):
        rows = slice(camera * p, (camera + 1) * p)
        reduced[rows, rows] += parts.cameras[camera]
    return reduced, folded


def _covariance(parts: _Parts, free: NDArray[np.bool_]) -> Floats:
    num_cameras, p = parts.camera_gradient.shape
    reduced, _ = _reduced(parts, _inverses(parts.blocks, 0.0))
    chosen = free.reshape(-1)
    covariance = np.zeros_like(reduced)
    covariance[np.ix_(chosen, chosen)] = np.linalg.pinv(
        reduced[np.ix_(chosen, chosen)], rcond=1e-10, hermitian=True
    )
    return covariance.reshape(num_cameras, p, num_cameras, p)
