"""Triangulate and refine the joints of one person: the loops of `triangulate.py`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.kernels.compile import kernel
from e3pose.kernels.nullspace import null_vector
from e3pose.triangulate import MIN_VIEWS, NOISE_PX, NOISE_SCORES, OUTLIER_SIGMAS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LOW, MIDDLE, HIGH = NOISE_SCORES
LOW_PX, MIDDLE_PX, HIGH_PX = NOISE_PX


@kernel
def place_person(
    group: Integers,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    projections: Floats,
    steps: int,
    reject_outliers: bool,
    seen: Integers,
    precisions: Floats,
    scratch: Floats,
    joints_m: Floats,
    joint_scores: Floats,
    errors_px: Floats,
) -> int:
    """Place all joints of the person whose poses are `group`; return how many were found.

    `seen` and `precisions` are scratch of one number a camera, `scratch` of `(4, 4, 4)`; the last
    three are written: `(num_joints, 3)`, `(num_joints,)` and `(num_joints,)`.
    """
    found = 0
    for joint in range(scores.shape[1]):
        num_views = 0
        for index in range(len(group)):
            score = scores[group[index], joint]
            if score > 0:
                seen[num_views] = group[index]
                precisions[num_views] = 1.0 / _noise_px(score)
                num_views += 1
        point = joints_m[joint]
        point[:] = np.nan
        joint_scores[joint] = 0.0
        errors_px[joint] = np.nan
        if num_views < MIN_VIEWS:
            continue
        views = seen[:num_views]
        _triangulate(joint, views, cameras, pixels, scores, projections, scratch, point)
        if not math.isfinite(point[0] + point[1] + point[2]):
            continue
        found += 1
        _refine(
            joint,
            views,
            cameras,
            pixels,
            projections,
            precisions,
            steps,
            reject_outliers,
            scratch,
            point,
        )
        total = error_sum = 0.0
        for index in range(num_views):
            error2 = _error2(projections[cameras[views[index]]], pixels[views[index], joint], point)
            belief = 1.0
            if reject_outliers:
                belief = 1.0 / (1.0 + error2 * (precisions[index] / OUTLIER_SIGMAS) ** 2)
            total += scores[views[index], joint] * belief
            error_sum += math.sqrt(error2)
        joint_scores[joint] = total / num_views
        errors_px[joint] = error_sum / num_views
    return found


@kernel
def _noise_px(score: float) -> float:
    if score <= LOW:
        return LOW_PX
    if score <= MIDDLE:
        return LOW_PX + (MIDDLE_PX - LOW_PX) * ((score - LOW) / (MIDDLE - LOW))
    return MIDDLE_PX + (HIGH_PX - MIDDLE_PX) * ((score - MIDDLE) / (HIGH - MIDDLE))


@kernel
def _triangulate(
    joint: int,
    views: Integers,
    cameras: Integers,
    pixels: Floats,
    scores: Floats,
    projections: Floats,
    scratch: Floats,
    point: Floats,
) -> None:
    """Write the paper's DLT to `point`; leave it NaN behind a camera that saw it."""
    m00 = m01 = m02 = m03 = m11 = m12 = m13 = m22 = m23 = m33 = 0.0
    for index in range(len(views)):
        p = projections[cameras[views[index]]]
        score = scores[views[index], joint]
        for axis in range(2):
            at = pixels[views[index], joint, axis]
            a = at * p[2, 0] - p[axis, 0]
            b = at * p[2, 1] - p[axis, 1]
            c = at * p[2, 2] - p[axis, 2]
            d = at * p[2, 3] - p[axis, 3]
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
    m = scratch[0]
    m[0, 0], m[0, 1], m[0, 2], m[0, 3] = m00, m01, m02, m03
    m[1, 1], m[1, 2], m[1, 3] = m11, m12, m13
    m[2, 2], m[2, 3], m[3, 3] = m22, m23, m33
    out = scratch[1, 0]
    null_vector(m, scratch[2:], out)
    x, y, z = out[0] / out[3], out[1] / out[3], out[2] / out[3]
    for index in range(len(views)):
        p = projections[cameras[views[index]]]
        if not p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3] > 0:
            return
    point[0], point[1], point[2] = x, y, z


@kernel
def _refine(
    joint: int,
    views: Integers,
    cameras: Integers,
    pixels: Floats,
    projections: Floats,
    precisions: Floats,
    steps: int,
    reject_outliers: bool,
    scratch: Floats,
    point: Floats,
) -> None:
    """Move `point` by Gauss-Newton steps, unless that leads behind a camera or to a larger loss."""
    if steps == 0:
        return
    x, y, z = point[0], point[1], point[2]
    for _ in range(steps):
        n00 = n01 = n02 = n11 = n12 = n22 = g0 = g1 = g2 = 0.0
        for index in range(len(views)):
            p = projections[cameras[views[index]]]
            keypoint = pixels[views[index], joint]
            inverse = 1.0 / (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
            u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) * inverse
            v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) * inverse
            error_u, error_v = u - keypoint[0], v - keypoint[1]
            weight = precisions[index] * precisions[index]
            if reject_outliers:
                error2 = error_u * error_u + error_v * error_v
                weight /= 1.0 + error2 * (precisions[index] / OUTLIER_SIGMAS) ** 2
            ua = (p[0, 0] - u * p[2, 0]) * inverse
            ub = (p[0, 1] - u * p[2, 1]) * inverse
            uc = (p[0, 2] - u * p[2, 2]) * inverse
            va = (p[1, 0] - v * p[2, 0]) * inverse
            vb = (p[1, 1] - v * p[2, 1]) * inverse
            vc = (p[1, 2] - v * p[2, 2]) * inverse
            n00 += weight * (ua * ua + va * va)
            n01 += weight * (ua * ub + va * vb)
            n02 += weight * (ua * uc + va * vc)
            n11 += weight * (ub * ub + vb * vb)
            n12 += weight * (ub * uc + vb * vc)
            n22 += weight * (uc * uc + vc * vc)
            g0 += weight * (ua * error_u + va * error_v)
            g1 += weight * (ub * error_u + vb * error_v)
            g2 += weight * (uc * error_u + vc * error_v)
        c00 = n11 * n22 - n12 * n12
        c01 = n02 * n12 - n01 * n22
        c02 = n01 * n12 - n02 * n11
        inverse = 1.0 / (n00 * c00 + n01 * c01 + n02 * c02)
        c11 = n00 * n22 - n02 * n02
        c12 = n01 * n02 - n00 * n12
        c22 = n00 * n11 - n01 * n01
        x -= (c00 * g0 + c01 * g1 + c02 * g2) * inverse
        y -= (c01 * g0 + c11 * g1 + c12 * g2) * inverse
        z -= (c02 * g0 + c12 * g1 + c22 * g2) * inverse
    last = scratch[1, 1, :3]
    last[0], last[1], last[2] = x, y, z
    first_loss = last_loss = 1.0 if reject_outliers else 0.0
    for index in range(len(views)):
        p = projections[cameras[views[index]]]
        if not p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3] > 0:
            return
        keypoint = pixels[views[index], joint]
        first = _error2(p, keypoint, point) * precisions[index] ** 2
        second = _error2(p, keypoint, last) * precisions[index] ** 2
        if reject_outliers:
            first_loss *= 1.0 + first / OUTLIER_SIGMAS**2
            last_loss *= 1.0 + second / OUTLIER_SIGMAS**2
        else:
            first_loss += first
            last_loss += second
    if last_loss <= first_loss:
        point[0], point[1], point[2] = x, y, z


@kernel
def _error2(p: Floats, keypoint: Floats, point: Floats) -> float:
    x, y, z = point[0], point[1], point[2]
    inverse = 1.0 / (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
    u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) * inverse - keypoint[0]
    v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) * inverse - keypoint[1]
    return u * u + v * v
