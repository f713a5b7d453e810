"""Bundle adjustment of cameras with points, or with a rigid board.

Triggs et al., "Bundle adjustment - a modern synthesis" (2000); Hartley and Zisserman, "Multiple
view geometry" (2nd ed.), chapter 18. Residuals are pixels of the real image to first order: the
ideal residual times the derivative of the lens at the observation, so that every lens model counts
alike and the adjustment itself is that of a pinhole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from e3pose.base.arrays import Floats
from e3pose.calibrate.least_squares import Linearised, Solution, solve
from e3pose.calibrate.moved_cameras import (
    LENS,
    NUM_LENS,
    NUM_PARAMETERS,
    POSE,
    Cameras,
    first_lenses,
)
from e3pose.model.camera import Rig

LENS_STEP = 1e-5  # normalised units, for the derivative of the lens
MIN_DEPTH = 1e-3  # metres; nearer points count as this far


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Observations of cameras, in ideal normalised coordinates.

    Attributes:
        points: `(num_cameras, num_blocks, num_points, 2)`; 0 where not seen.
        whiten: `(num_cameras, num_blocks, num_points, 2, 2)` from ideal residuals to real pixels in
            standard deviations; 0 where not seen.
    """

    points: Floats
    whiten: Floats

    @property
    def seen(self) -> NDArray[np.bool_]:
        """`(num_cameras, num_blocks, num_points)`."""
        return np.asarray(self.whiten.any(axis=(-1, -2)))


def observe(rig: Rig, keypoints_px: Floats, sigma_px: Floats) -> Observed:
    """Take the lenses off pixels.

    Args:
        rig: the cameras.
        keypoints_px: `(num_cameras, num_blocks, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_blocks, num_points)` standard deviation of either coordinate.
    """
    points, whiten = [], []
    for camera, pixels, sigma in zip(rig.cameras, keypoints_px, sigma_px, strict=True):
        flat = pixels.reshape(-1, 2)
        ideal = camera.normalise(flat)
        slope = np.empty((*flat.shape, 2))
        for axis, step in enumerate(np.eye(2) * LENS_STEP):
            ahead, behind = camera.lens.distort(ideal + step), camera.lens.distort(ideal - step)
            slope[..., axis] = (ahead - behind) / (2 * LENS_STEP)
        scaled = camera.K[:2, :2] @ slope / sigma.reshape(-1, 1, 1)
        good = np.isfinite(scaled).all(axis=(-1, -2)) & np.isfinite(ideal).all(axis=-1)
        points.append(np.where(good[:, None], ideal, 0.0).reshape(pixels.shape))
        whiten.append(np.where(good[:, None, None], scaled, 0.0).reshape(*pixels.shape, 2))
    return Observed(np.stack(points), np.stack(whiten))


def root_mean_square(values: Floats, axis: int | tuple[int, ...]) -> Floats:
    """Return the root mean square of the finite values of `(*batch)`, over axes.

    Args:
        values: NaN where missing.
        axis: one or several.

    Returns:
        NaN where all are missing.
    """
    there = np.isfinite(values)
    count = there.sum(axis=axis)
    total = np.where(there, values**2, 0.0).sum(axis=axis)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """A rig after adjustment.

    Attributes:
        rig: the cameras.
        blocks: `(num_blocks, 3)` points, or `(num_blocks, 4, 4)` board-to-world transforms, metres.
        weights: `(num_cameras, num_blocks, num_points)` how much each observation counted; 0 where
            not seen.
        residuals: `(num_cameras, num_blocks, num_points, 2)` in standard deviations; NaN where not
            seen.
        covariance: `(num_cameras, 10, num_cameras, 10)` of rotation (radians), translation (metres)
            and lens, for independent errors of the stated deviations; 0 where held.
    """

    rig: Rig
    blocks: Floats
    weights: Floats
    residuals: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True)
class AdjustOptions:
    """The free parameters of an adjustment, and its limit for outliers.

    Attributes:
        outlier_sigmas: residual at which Cauchy's loss halves the weight; infinite for none.
        free: `(num_cameras,)` which cameras may move; all but the first by default.
        lenses: `(num_cameras, 4, num_cameras, 4)` covariance of how far lenses are expected to be
            from those of the rig; 0 holds them, as None does.
        max_steps: at most so many steps.
    """

    outlier_sigmas: float
    free: NDArray[np.bool_] | None = None
    lenses: Floats | None = None
    max_steps: int = 60


def adjust_points(
    rig: Rig,
    points_m: Floats,
    keypoints_px: Floats,
    sigma_px: Floats,
    options: AdjustOptions,
) -> Adjusted:
    """Adjust cameras and points.

    Args:
        rig: where the cameras are thought to be.
        points_m: `(num_points, 3)` where the points are thought to be.
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.
        options: what may move.
    """
    first = first_lenses(rig)
    seen = observe(first, keypoints_px[:, :, None], sigma_px[:, :, None])

    def linearise(state: tuple[Cameras, Floats]) -> Linearised:
        return linearise_points(*state, seen)

    def retract(
        state: tuple[Cameras, Floats], by_camera: Floats, by_block: Floats
    ) -> tuple[Cameras, Floats]:
        return state[0].moved(by_camera), state[1] + by_block

    solution = _solve((Cameras.of(rig), points_m), linearise, retract, options)
    return _adjusted(first, solution, seen, linearise(solution.state).residuals)


def linearise_points(cameras: Cameras, points_m: Floats, seen: Observed) -> Linearised:
    """Return residuals of points and their derivatives.

    Args:
        cameras: where they are.
        points_m: `(num_points, 3)`.
        seen: what to compare with, one point to a block.
    """
    rotated = (points_m @ np.swapaxes(cameras.rotations, -1, -2))[:, :, None]
    r, A, to_camera = _residuals(cameras, rotated, seen)
    return Linearised(r, A, _by_world(to_camera, cameras))


def adjust_boards(
    rig: Rig,
    boards: Floats,
    corners_m: Floats,
    corners_px: Floats,
    sigma_px: float,
    options: AdjustOptions,
) -> Adjusted:
    """Adjust cameras and the places of a rigid board at several times.

    Args:
        rig: where the cameras are thought to be.
        boards: `(num_times, 4, 4)` board-to-world transforms, metres.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_cameras, num_times, num_corners, 2)` real pixels; NaN where not seen.
        sigma_px: standard deviation of a corner.
        options: what may move.
    """
    first = first_lenses(rig)
    seen = observe(first, corners_px, np.full(corners_px.shape[:-1], sigma_px))

    def linearise(state: tuple[Cameras, Floats]) -> Linearised:
        cameras, boards = state
        turned = np.einsum("fij,mj->fmi", boards[:, :3, :3], corners_m)
        world = turned + boards[:, None, :3, 3]
        rotated = np.einsum("cij,fmj->cfmi", cameras.rotations, world)
        r, A, to_camera = _residuals(cameras, rotated, seen)
        by_world = _by_world(to_camera, cameras)
        by_turn = np.cross(turned[:, :, None], by_world)
        return Linearised(r, A, np.concatenate([by_turn, by_world], axis=-1))

    def retract(
        state: tuple[Cameras, Floats], by_camera: Floats, by_block: Floats
    ) -> tuple[Cameras, Floats]:
        moved = np.array(state[1])
        moved[:, :3, :3] = Rotation.from_rotvec(by_block[:, :3]).as_matrix() @ moved[:, :3, :3]
        moved[:, :3, 3] += by_block[:, 3:]
        return state[0].moved(by_camera), moved

    solution = _solve((Cameras.of(rig), boards), linearise, retract, options)
    return _adjusted(first, solution, seen, linearise(solution.state).residuals)


def _residuals(cameras: Cameras, rotated: Floats, seen: Observed) -> tuple[Floats, Floats, Floats]:
    """Return residuals, derivatives by the camera and by the point in the camera frame.

    Args:
        cameras: where they are.
        rotated: `(num_cameras, num_blocks, num_points, 3)` points turned into each camera's axes.
        seen: what to compare with.
    """
    in_camera = rotated + cameras.translations[:, None, None]
    depth = np.maximum(in_camera[..., 2], MIN_DEPTH)
    lenses = cameras.lenses[:, None, None]
    factor, k1, middle = np.exp(lenses[..., :1]), lenses[..., 1:2], lenses[..., 2:]
    pinhole = in_camera[..., :2] / depth[..., None]
    square = (pinhole**2).sum(axis=-1, keepdims=True)
    scaled = factor * pinhole
    # The second coefficient is that of Fitzgibbon's division model (2001), to its second order.
    bent, slope = 1 + k1 * square * (1 + 2 * k1 * square), 1 + 4 * k1 * square
    ideal = scaled * bent + middle
    residuals = np.einsum("cfmuv,cfmv->cfmu", seen.whiten, ideal - seen.points)
    by_pinhole = (factor * bent)[..., None] * np.eye(2)
    by_pinhole += (2 * k1 * slope * scaled)[..., :, None] * pinhole[..., None, :]
    by_point = np.zeros((*depth.shape, 2, 3))
    by_point[..., 0, 0] = by_point[..., 1, 1] = 1 / depth
    by_point[..., 2] = -pinhole / depth[..., None]
    to_camera = seen.whiten @ (by_pinhole @ by_point)
    by_turn = np.cross(rotated[..., None, :], to_camera)
    by_lens = np.stack([scaled * bent, scaled * square * slope], axis=-1)
    by_lens = np.concatenate([seen.whiten @ by_lens, seen.whiten], axis=-1)
    return residuals, np.concatenate([by_turn, to_camera, by_lens], axis=-1), to_camera


def _by_world(to_camera: Floats, cameras: Cameras) -> Floats:
    """Return derivatives `(num_cameras, *batch, 3)` by a point in the world.

    Args:
        to_camera: `(num_cameras, *batch, 3)` by the point in the camera frame.
        cameras: where they are.
    """
    flat = to_camera.reshape(len(to_camera), -1, 3)
    return np.asarray((flat @ cameras.rotations).reshape(to_camera.shape))


def _solve(
    state: tuple[Cameras, Floats],
    linearise: Callable[[tuple[Cameras, Floats]], Linearised],
    retract: Callable[[tuple[Cameras, Floats], Floats, Floats], tuple[Cameras, Floats]],
    options: AdjustOptions,
) -> Solution[tuple[Cameras, Floats]]:
    number = len(state[0].translations)
    free = np.arange(number) > 0 if options.free is None else options.free
    chosen = np.zeros((number, NUM_PARAMETERS), dtype=bool)
    chosen[:, POSE] = free[:, None]
    flat = lens_precision(options.lenses, number)
    if options.lenses is not None:
        chosen[:, LENS] = np.diag(flat).reshape(number, -1)[:, LENS] > 0

    def prior(state: tuple[Cameras, Floats]) -> tuple[Floats, Floats]:
        distances = np.zeros((number, NUM_PARAMETERS))
        distances[:, LENS] = state[0].lenses
        return distances, flat

    return solve(
        state, linearise, retract, chosen, prior, options.outlier_sigmas, options.max_steps
    )


def lens_precision(lenses: Floats | None, number: int) -> Floats:
    """Return `(number * 10, number * 10)` inverse covariance of lenses, 0 for all that is held.

    Args:
        lenses: as `AdjustOptions` has it.
        number: of cameras.
    """
    precision = np.zeros((number, NUM_PARAMETERS, number, NUM_PARAMETERS))
    if lenses is not None:
        inverse = np.array(lenses.reshape(number * NUM_LENS, -1))
        known = np.ix_(*(2 * [np.diag(inverse) > 0]))
        inverse[known] = np.linalg.inv(inverse[known])
        precision[:, LENS, :, LENS] = inverse.reshape(lenses.shape)
    return precision.reshape(number * NUM_PARAMETERS, -1)


def _adjusted(
    rig: Rig, solution: Solution[tuple[Cameras, Floats]], seen: Observed, residuals: Floats
) -> Adjusted:
    there = seen.seen
    return Adjusted(
        solution.state[0].rig(rig),
        solution.state[1],
        np.where(there, solution.weights, 0.0),
        np.where(there[..., None], residuals, np.nan),
        solution.camera_covariance,
    )
