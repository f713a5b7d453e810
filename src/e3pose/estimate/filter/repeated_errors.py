"""The uncertainty that remains after any number of views with repeated errors.

Biases are learned from differences between views; an error that all of them make together stays,
for as long as the detector's errors last. Many views make the filter surer than that, so it is
added to the covariances that are reported.
"""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import MemoryTerms
from e3pose.model.projection import MIN_DEPTH_M, shown_at

# tuned: share | lab/experiments/2026-11-23-errors-that-views-repeat.md | stays
STAYS = 0.3  # of the variance of lasting errors: what learned biases leave
# tuned: m | not recorded | half and twice
MOST_M = 0.03  # standard deviation along an axis on which views give no information
# The same of errors as large as the learned biases: what all views have in common is in no bias.
# tuned: m | not recorded | half and twice
MOST_LASTING_M = 0.1
# tuned: variances | not recorded | half and twice
COMMON = 3.0  # of the square of a bias, as a variance
# tuned: s | not recorded | half and twice
RECENT_S = 0.5  # since the look, for biases that are compared with what is usual
LEAST_PX2 = 1e-9  # numerics
LEAST_WEIGHT = 0.01  # numerics: of a view that came just now and shows every joint at its best


@kernel
def weigh_views(
    last_seen_s: Floats,
    delivered: Floats,
    sigma_px: Floats,
    terms: MemoryTerms,
    weights: Floats,
) -> None:
    """Fill `weights` `(num_cameras,)`: the inverse variance of the errors views repeat, in 1/px2.

    Args:
        last_seen_s: `(num_cameras,)` of one person, as in `Belief`.
        delivered: `(num_cameras,)` likewise.
        sigma_px: `(num_cameras,)` of keypoints of the best score.
        terms: how long the detector's errors last.
        weights: filled; 0 of cameras whose last view is too old.
    """
    for camera in range(len(weights)):
        weight = delivered[camera] * math.exp(-2.0 * last_seen_s[camera] / terms.lasting_s)
        variance = _stays_px2(sigma_px[camera], terms)
        weights[camera] = weight / variance if weight > LEAST_WEIGHT else 0.0


@kernel
def weigh_biases(
    bias_px: Floats,
    last_seen_s: Floats,
    sigma_px: Floats,
    terms: MemoryTerms,
    weights: Floats,
    lasting: Floats,
    bias_share: Floats,
) -> None:
    """Fill `lasting` `(num_cameras,)`: `weights` of a joint by the size of its biases.

    Args:
        bias_px: `(num_cameras, 2)` of the joint of one person.
        last_seen_s: `(num_cameras,)` of the person.
        sigma_px: `(num_cameras,)` of keypoints of the best score.
        terms: how long the detector's errors last.
        weights: `(num_cameras,)` of `weigh_views`.
        lasting: filled.
        bias_share: `(2,)` sum of the squares of recent biases over the variance, and their number.
    """
    for camera in range(len(weights)):
        square = (bias_px[camera, 0] ** 2 + bias_px[camera, 1] ** 2) / 2.0
        stays = _stays_px2(sigma_px[camera], terms)
        lasting[camera] = weights[camera] * stays / (stays + COMMON * square)
        if weights[camera] > 0.0 and last_seen_s[camera] < RECENT_S:
            bias_share[0] += square / max(sigma_px[camera] ** 2, LEAST_PX2)
            bias_share[1] += 1.0


@kernel
def _stays_px2(sigma_px: float, terms: MemoryTerms) -> float:
    return float(max(STAYS * terms.most * sigma_px**2, LEAST_PX2))


@kernel
def find_repeated(
    joint: Floats, weights: Floats, projections: Floats, most_m: float, covariance_m2: Floats
) -> None:
    """Fill the covariance that errors which repeat themselves leave of a joint.

    Args:
        joint: its place, metres, in the first three entries.
        weights: of `weigh_views`.
        projections: `(num_cameras, 3, 4)`.
        most_m: standard deviation along an axis on which views give no information.
        covariance_m2: `(3, 3)` filled.
    """
    xx = yy = zz = 1.0 / most_m**2
    xy = xz = yz = 0.0
    for camera in range(len(weights)):
        weight = weights[camera]
        if weight > 0.0:
            depth, _, _, ux, uy, uz, vx, vy, vz = shown_at(
                projections[camera], joint[0], joint[1], joint[2]
            )
            if depth > MIN_DEPTH_M:
                xx += weight * (ux * ux + vx * vx)
                xy += weight * (ux * uy + vx * vy)
                xz += weight * (ux * uz + vx * vz)
                yy += weight * (uy * uy + vy * vy)
                yz += weight * (uy * uz + vy * vz)
                zz += weight * (uz * uz + vz * vz)
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    inverse = 1.0 / (xx * cxx + xy * cxy + xz * cxz)
    covariance_m2[0, 0] = inverse * cxx
    covariance_m2[1, 1] = inverse * (xx * zz - xz * xz)
    covariance_m2[2, 2] = inverse * (xx * yy - xy * xy)
    off = inverse * cxy
    covariance_m2[0, 1] = off
    covariance_m2[1, 0] = off
    off = inverse * cxz
    covariance_m2[0, 2] = off
    covariance_m2[2, 0] = off
    off = inverse * (xy * xz - xx * yz)
    covariance_m2[1, 2] = off
    covariance_m2[2, 1] = off
