"""Triangulate and refine the joints of one person: the paper's weighted DLT, and its refinement.

Each row of the DLT's matrix (paper eq. (1) to (3)) is divided by its norm and multiplied by the
keypoint's score. The norm depends on the scale of the projections and on the world's origin, as in
the paper. The DLT minimises an algebraic error; a few Gauss-Newton steps on the errors in pixels,
each divided by the noise that its score promises, give the most likely point instead. Rejecting
outliers reweights each view by 1 / (1 + r^2) at every step, r being its error in units of
`OUTLIER_SIGMAS` standard deviations.

Each function handles all joints of a person and indexes whole arrays: a call with arrays, or a
slice of one, costs as much as a few rows of arithmetic.

The solution of the DLT is the unit vector that a symmetric positive 4 x 4 matrix shrinks most
(`null_vector`).
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.model.projection import shown_at

MIN_VIEWS = 2  # definition: of a triangulation
# Standard deviation in pixels of a keypoint by its score. Detectors guess below a score of about
# 0.4 (joints that are hidden), where errors are five times those of joints that are clearly seen.
# tuned: scores | simulated noise of the workloads, docs/decisions/0001-matching.md | a line from 16
#   to 2 px moves PCP by 0.1 at most
NOISE_SCORES = (0.4, 0.6, 1.0)
# tuned: px | simulated noise of the workloads, docs/decisions/0001-matching.md | a line from 16 to
#   2 px moves PCP by 0.1 at most
NOISE_PX = (15.0, 3.0, 2.3)
# Residual, in standard deviations, at which a keypoint's weight is halved when outliers are
# rejected: 2.5 is the usual compromise, 1 % of normal errors are larger.
OUTLIER_SIGMAS = 2.5  # definition: 1 % of normal errors are larger
# Beyond these a Gauss-Newton step says nothing: its linear picture of a camera holds over a small
# part of the distance to it. Estimates that break them are left as the DLT made them.
MIN_DEPTH_M = 0.2  # numerics: of a step
MAX_STEP_M = 0.5  # numerics: of a step
LOW, MIDDLE, HIGH = NOISE_SCORES
LOW_PX, MIDDLE_PX, HIGH_PX = NOISE_PX
MAX_ITERATIONS = 16  # numerics: then rotations finish
CONVERGED2 = 1e-22  # numerics: squared error, relative to the squared length of the vector
TINY2 = 1e-26  # numerics: the same for a vector that no longer changes but for rounding
SHRINKING2 = 1e-2  # numerics: squared factor by which changes must shrink to foresee the rest
SINGULAR = 1e-18  # numerics: pivots below this share of the trace are rounding errors
JACOBI_SWEEPS = 12  # numerics: of 4 x 4 numbers


@kernel
def noise_px(score: float) -> float:
    """Return the expected error in pixels of a keypoint with this score."""
    if score <= LOW:
        return LOW_PX
    if score <= MIDDLE:
        return LOW_PX + (MIDDLE_PX - LOW_PX) * ((score - LOW) / (MIDDLE - LOW))
    return MIDDLE_PX + (HIGH_PX - MIDDLE_PX) * ((score - MIDDLE) / (HIGH - MIDDLE))


@kernel
def triangulate_person(
    group: Integers,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    projections: Floats,
    scratch: Floats,
    joints_m: Floats,
) -> int:
    """Write the paper's DLT of the poses in `group` to `joints_m`; return how many are not NaN.

    `pixels` and `scores` are of all poses, `scratch` is `(4, 4, 4)`, `joints_m` `(num_joints, 3)`.
    """
    m, out, rest = scratch[0], scratch[1, 0], scratch[2:]
    found = 0
    for joint in range(scores.shape[1]):
        m00 = m01 = m02 = m03 = m11 = m12 = m13 = m22 = m23 = m33 = 0.0
        num_views = 0
        for index in range(len(group)):
            pose = group[index]
            score = scores[pose, joint]
            if score <= 0:
                continue
            num_views += 1
            k = cameras[pose]
            for axis in range(2):
                at = pixels[pose, joint, axis]
                a = at * projections[k, 2, 0] - projections[k, axis, 0]
                b = at * projections[k, 2, 1] - projections[k, axis, 1]
                c = at * projections[k, 2, 2] - projections[k, axis, 2]
                d = at * projections[k, 2, 3] - projections[k, axis, 3]
                weight = score * score / (a * a + b * b + c * c + d * d)
                wa, wb, wc = weight * a, weight * b, weight * c
                m00 += wa * a
                m01 += wa * b
                m02 += wa * c
                m03 += wa * d
                m11 += wb * b
                m12 += wb * c
                m13 += wb * d
                m22 += wc * c
                m23 += wc * d
                m33 += weight * d * d
        joints_m[joint, 0] = joints_m[joint, 1] = joints_m[joint, 2] = np.nan
        if num_views < MIN_VIEWS:
            continue
        m[0, 0], m[0, 1], m[0, 2], m[0, 3] = m00, m01, m02, m03
        m[1, 1], m[1, 2], m[1, 3] = m11, m12, m13
        m[2, 2], m[2, 3], m[3, 3] = m22, m23, m33
        null_vector(m, rest, out)
        x, y, z = out[0] / out[3], out[1] / out[3], out[2] / out[3]
        usable = math.isfinite(x + y + z)
        for index in range(len(group)):
            if scores[group[index], joint] > 0:
                usable &= shown_at(projections[cameras[group[index]]], x, y, z)[0] > 0
        if usable:
            joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2] = x, y, z
            found += 1
    return found


@kernel
def refine_person(
    group: Integers,
    cameras: Integers,
    pixels: Floats,
    precisions: Floats,
    projections: Floats,
    steps: int,
    reject_outliers: bool,
    joints_m: Floats,
) -> None:
    """Move `joints_m` `(num_joints, 3)` by Gauss-Newton steps, unless that makes them worse.

    `precisions` `(num_poses, num_joints)` are reciprocals of the noise in pixels, 0 where not seen.
    """
    for joint in range(joints_m.shape[0]):
        x, y, z = joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2]
        if math.isnan(x):
            continue
        first_loss = 1.0
        for step in range(steps + 1):
            last = step == steps
            far_enough, loss, dx, dy, dz = _gauss_newton_step(
                group,
                cameras,
                pixels[:, joint],
                precisions[:, joint],
                projections,
                reject_outliers,
                last,
                (x, y, z),
            )
            if not far_enough:
                break
            if step == 0:
                first_loss = loss
            if last:
                if loss <= first_loss:
                    joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2] = x, y, z
                break
            if not dx * dx + dy * dy + dz * dz <= MAX_STEP_M**2:
                break
            x, y, z = x - dx, y - dy, z - dz


@kernel
def _gauss_newton_step(
    group: Integers,
    cameras: Integers,
    pixels: Floats,
    precisions: Floats,
    projections: Floats,
    reject_outliers: bool,
    last: bool,
    point: tuple[float, float, float],
) -> tuple[bool, float, float, float, float]:
    """Return whether every view is far enough, the loss at a point, and the step to take off.

    `pixels` `(num_poses, 2)` and `precisions` `(num_poses,)` are those of one joint. The loss is
    the sum of squares in units of the noise or, with `reject_outliers`, the product whose logarithm
    is the Cauchy loss. The last step is asked for its loss alone.
    """
    x, y, z = point
    robust = 1.0 / OUTLIER_SIGMAS**2 if reject_outliers else 0.0
    n00 = n01 = n02 = n11 = n12 = n22 = g0 = g1 = g2 = 0.0
    product = 1.0
    total = 0.0
    far_enough = True
    for index in range(len(group)):
        pose = group[index]
        weight = precisions[pose] ** 2
        if weight == 0:
            continue
        depth, u, v, ua, ub, uc, va, vb, vc = shown_at(projections[cameras[pose]], x, y, z)
        far_enough &= depth >= MIN_DEPTH_M
        error_u, error_v = u - pixels[pose, 0], v - pixels[pose, 1]
        squares = weight * (error_u * error_u + error_v * error_v)
        total += squares
        if reject_outliers:
            product *= 1.0 + robust * squares
            weight /= 1.0 + robust * squares
        if last:
            continue
        n00 += weight * (ua * ua + va * va)
        n01 += weight * (ua * ub + va * vb)
        n02 += weight * (ua * uc + va * vc)
        n11 += weight * (ub * ub + vb * vb)
        n12 += weight * (ub * uc + vb * vc)
        n22 += weight * (uc * uc + vc * vc)
        g0 += weight * (ua * error_u + va * error_v)
        g1 += weight * (ub * error_u + vb * error_v)
        g2 += weight * (uc * error_u + vc * error_v)
    loss = product if reject_outliers else total
    if last or not far_enough:
        return far_enough, loss, 0.0, 0.0, 0.0
    c00 = n11 * n22 - n12 * n12
    c01 = n02 * n12 - n01 * n22
    c02 = n01 * n12 - n02 * n11
    scale = 1.0 / (n00 * c00 + n01 * c01 + n02 * c02)
    c12 = n01 * n02 - n00 * n12
    dx = scale * (c00 * g0 + c01 * g1 + c02 * g2)
    dy = scale * (c01 * g0 + (n00 * n22 - n02 * n02) * g1 + c12 * g2)
    dz = scale * (c02 * g0 + c12 * g1 + (n00 * n11 - n01 * n01) * g2)
    return far_enough, loss, dx, dy, dz


@kernel
def score_person(
    group: Integers,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    precisions: Floats,
    projections: Floats,
    reject_outliers: bool,
    joints_m: Floats,
    joint_scores: Floats,
    errors_px: Floats,
) -> None:
    """Write score `(num_joints,)` and mean reprojection error in pixels `(num_joints,)`."""
    robust = 1.0 / OUTLIER_SIGMAS**2 if reject_outliers else 0.0
    for joint in range(joints_m.shape[0]):
        x, y, z = joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2]
        joint_scores[joint] = 0.0
        errors_px[joint] = np.nan
        if math.isnan(x):
            continue
        num_views = 0
        total = error_sum = 0.0
        for index in range(len(group)):
            pose = group[index]
            if scores[pose, joint] <= 0:
                continue
            num_views += 1
            _, u, v, _, _, _, _, _, _ = shown_at(projections[cameras[pose]], x, y, z)
            squares = (u - pixels[pose, joint, 0]) ** 2 + (v - pixels[pose, joint, 1]) ** 2
            error_sum += math.sqrt(squares)
            total += scores[pose, joint] / (1.0 + squares * robust * precisions[pose, joint] ** 2)
        joint_scores[joint] = total / num_views
        errors_px[joint] = error_sum / num_views


@kernel
def null_vector(m: Floats, scratch: Floats, out: Floats) -> None:
    """Write the eigenvector of the smallest eigenvalue of `m` `(4, 4)` to `out` `(4,)`.

    Inverse iteration on an LDL factorisation converges in two or three rounds where the views
    agree; where they do not, Jacobi rotations finish. `scratch` is `(2, 4, 4)`.
    """
    floor = SINGULAR * (m[0, 0] + m[1, 1] + m[2, 2] + m[3, 3])
    i0 = 1.0 / max(m[0, 0], floor)
    l10, l20, l30 = m[0, 1] * i0, m[0, 2] * i0, m[0, 3] * i0
    i1 = 1.0 / max(m[1, 1] - l10 * m[0, 1], floor)
    t21 = m[1, 2] - l20 * m[0, 1]
    t31 = m[1, 3] - l30 * m[0, 1]
    l21, l31 = t21 * i1, t31 * i1
    i2 = 1.0 / max(m[2, 2] - l20 * m[0, 2] - l21 * t21, floor)
    t32 = m[2, 3] - l30 * m[0, 2] - l31 * t21
    l32 = t32 * i2
    i3 = 1.0 / max(m[3, 3] - l30 * m[0, 3] - l31 * t31 - l32 * t32, floor)

    # Scaled to a last coordinate of 1, as the DLT wants it: a division less than a unit vector.
    x = y = z = previous = 0.0
    for _ in range(MAX_ITERATIONS):
        b = y - l10 * x
        c = z - l20 * x - l21 * b
        w = (1.0 - l30 * x - l31 * b - l32 * c) * i3
        nz = c * i2 - l32 * w
        ny = b * i1 - l21 * nz - l31 * w
        nx = x * i0 - l10 * ny - l20 * nz - l30 * w
        scale = 1.0 / w
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        change = (nx - x) ** 2 + (ny - y) ** 2 + (nz - z) ** 2
        x, y, z = nx, ny, nz
        size = 1.0 + x * x + y * y + z * z
        # Changes shrink by a constant factor, so the next one will be about change^2 / previous.
        shrinking = change < SHRINKING2 * previous
        if change <= TINY2 * size or (shrinking and change**2 <= CONVERGED2 * size * previous):
            out[0], out[1], out[2], out[3] = x, y, z, 1.0
            return
        previous = change
    _jacobi(m, scratch, out)


@kernel
def _jacobi(m: Floats, scratch: Floats, out: Floats) -> None:
    a, vectors = scratch[0], scratch[1]
    for i in range(4):
        for j in range(4):
            a[i, j] = m[min(i, j), max(i, j)]
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(JACOBI_SWEEPS):
        for p in range(3):
            for q in range(p + 1, 4):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                t = t if theta >= 0 else -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(4):
                    kp, kq = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * kp - s * kq, s * kp + c * kq
                for k in range(4):
                    pk, qk = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * pk - s * qk, s * pk + c * qk
                for k in range(4):
                    kp, kq = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * kp - s * kq, s * kp + c * kq
    smallest = 0
    for i in range(1, 4):
        if a[i, i] < a[smallest, smallest]:
            smallest = i
    for k in range(4):
        out[k] = vectors[k, smallest]
