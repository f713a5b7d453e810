"""The uncertainty of a joint's pixel, and the distance of a keypoint from it."""

from __future__ import annotations

from typing import NamedTuple

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.model.projection import MIN_DEPTH_M, shown_at

# tuned: score | not recorded | half and twice
USED_SCORE = 0.05  # keypoints below this are not used
U, V, SPREAD, IN_FRONT = range(4)  # layout: planes of `Offers.projected`


@kernel
def projected_variance_px2(
    covariance: Floats, ux: float, uy: float, uz: float, vx: float, vy: float, vz: float
) -> float:
    """Return the mean variance of a shown point's two coordinates, from the gradients of both.

    Args:
        covariance: `(6, 6)` of the point's position and velocity.
        ux: gradient of the first coordinate, pixels per metre, as `uy` and `uz`.
        uy: see `ux`.
        uz: see `ux`.
        vx: of the second coordinate, as `vy` and `vz`.
        vy: see `vx`.
        vz: see `vx`.
    """
    variance_px2 = (
        covariance[0, 0] * (ux * ux + vx * vx)
        + covariance[1, 1] * (uy * uy + vy * vy)
        + covariance[2, 2] * (uz * uz + vz * vz)
    ) / 2
    variance_px2 += (
        covariance[0, 1] * (ux * uy + vx * vy)
        + covariance[0, 2] * (ux * uz + vx * vz)
        + covariance[1, 2] * (uy * uz + vy * vz)
    )
    return float(variance_px2)


class Beside(NamedTuple):
    """A keypoint beside the joint that it is of; without `known` the rest means nothing."""

    known: bool  # whether both are there
    du: float  # how far the keypoint is right of the joint, pixels
    dv: float  # and below it
    variance_px2: float  # the mean one of the joint's pixel coordinates
    ux: float  # gradients of the pixel by the place of the joint, pixels per metre
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float


@kernel
def beside(
    row: int,
    joint: int,
    state: Floats,
    covariance: Floats,
    projection: Floats,
    pixels: Floats,
    weights: Floats,
    bias_px: Floats,
) -> Beside:
    """Compare a keypoint with the joint that it is of.

    Args:
        row: of the detection in `pixels` and `weights`.
        joint: of the person.
        state: `(num_joints, 6)`.
        covariance: `(num_joints, 6, 6)`.
        projection: `(3, 4)`.
        pixels: `(num_rows, num_joints, 2)`.
        weights: `(num_rows, num_joints)`.
        bias_px: `(num_joints, 2)` learned of the view, taken off.
    """
    x, y, z = state[joint, 0], state[joint, 1], state[joint, 2]
    depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(projection, x, y, z)
    known = weights[row, joint] > USED_SCORE and depth > MIN_DEPTH_M
    du = pixels[row, joint, 0] - bias_px[joint, 0] - u
    dv = pixels[row, joint, 1] - bias_px[joint, 1] - v
    variance_px2 = projected_variance_px2(covariance[joint], ux, uy, uz, vx, vy, vz)
    return Beside(known, du, dv, variance_px2, ux, uy, uz, vx, vy, vz)
