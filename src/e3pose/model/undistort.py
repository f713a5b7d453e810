"""Undistort the keypoints of a slot: the kernel of `distortion.Distortion.undistort`.

The first guess, the Newton steps and the test at the end are the same, so a pixel without an
inverse is NaN here where it is NaN there. The points of a camera are taken `LANES` at a time; the
innermost loops have constant bounds and no branches, so that they become vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import LANES, kernel
from e3pose.model.camera import Rig
from e3pose.model.distortion import NEWTON_STEPS, TABLE_SIZE, TOLERANCE
from e3pose.model.pose import MAX_PIXEL, MISSING_SCORE

IDEAL, BROWN, FISHEYE = range(3)
SMALL_ERROR = TOLERANCE * 1e-3  # a point this near takes no more steps
# Where fx, skew, cx, fy, cy, the coefficients, the limits, the tilt and its inverse begin.
K, LENS, LIMITS, TILT, UPRIGHT = 0, 5, 17, 19, 28


class Lenses(NamedTuple):
    """The constants of a rig's lenses."""

    models: Integers  # (num_cameras,) IDEAL, BROWN or FISHEYE
    numbers: Floats  # (num_cameras, 37) K, 12 coefficients, limits of angle and radius, tilts
    tables: Floats  # (num_cameras, 2, TABLE_SIZE) real radius, and tangent, by angle


def make_lenses(rig: Rig) -> Lenses:
    """Collect the lenses of a rig."""
    models = np.full(len(rig), IDEAL, np.int64)
    numbers = np.zeros((len(rig), 37))
    tables = np.zeros((len(rig), 2, TABLE_SIZE))
    for index, camera in enumerate(rig.cameras):
        lens = camera.lens
        if len(lens.coefficients) == 0:
            continue
        models[index] = FISHEYE if lens.fisheye else BROWN
        numbers[index, K:LENS] = camera.K[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
        numbers[index, LENS:LIMITS] = lens.padded[: LIMITS - LENS]
        numbers[index, LIMITS:TILT] = lens.angle_limit, lens.radius_limit
        numbers[index, TILT:UPRIGHT] = lens.tilt.ravel()
        numbers[index, UPRIGHT:] = lens.upright.ravel()
        with np.errstate(all="ignore"):  # a model may end at a pole
            tables[index] = lens.table[0], np.tan(lens.table[1])
    return Lenses(models, numbers, tables)


@kernel
def undistort_slot(
    keypoints_px: Floats,
    scores: Floats,
    counts: Integers,
    models: Integers,
    numbers: Floats,
    tables: Floats,
    lanes: Floats,
    pixels: Floats,
) -> None:
    """Fill `pixels` `(num_poses, num_joints, 2)`, pose by pose; NaN where there is no inverse.

    What is no keypoint, by its score or its pixels, is NaN too, or as it was if the camera has no
    distortion. `lanes` is scratch of `6 * LANES` numbers: the real point, its radius, the ideal
    point (of a fisheye first the angle) and the error.
    """
    num_joints = scores.shape[2]
    out = pixels.reshape(-1)
    first = 0
    for camera in range(len(counts)):
        own_px, own_scores = keypoints_px[camera].reshape(-1), scores[camera].reshape(-1)
        num_points = counts[camera] * num_joints
        if models[camera] == IDEAL:
            for at in range(2 * num_points):
                out[2 * first + at] = own_px[at]
            first += num_points
            continue
        fx, skew, cx = numbers[camera, K], numbers[camera, K + 1], numbers[camera, K + 2]
        fy, cy = numbers[camera, K + 3], numbers[camera, K + 4]
        for start in range(0, num_points, LANES):
            size = min(LANES, num_points - start)
            for lane in range(LANES):
                x = y = np.nan
                if lane < size and own_scores[start + lane] >= MISSING_SCORE:
                    u, v = own_px[2 * (start + lane)], own_px[2 * (start + lane) + 1]
                    if abs(u) <= MAX_PIXEL and abs(v) <= MAX_PIXEL:
                        y = (v - cy) / fy
                        x = (u - cx - skew * y) / fx
                        x, y = through(numbers[camera], UPRIGHT, x, y)
                lanes[lane] = x
                lanes[LANES + lane] = y
                lanes[2 * LANES + lane] = math.sqrt(x * x + y * y)
            if models[camera] == FISHEYE:
                _solve_fisheye(numbers[camera], tables[camera], lanes)
            else:
                _solve_brown(numbers[camera], tables[camera], lanes)
            for lane in range(size):
                x, y = lanes[3 * LANES + lane], lanes[4 * LANES + lane]
                # Towards 90 degrees the tangent magnifies rounding, hence the share of the radius.
                small = lanes[5 * LANES + lane] <= TOLERANCE * (1 + lanes[2 * LANES + lane])
                if not (small and math.sqrt(x * x + y * y) <= numbers[camera, LIMITS + 1]):
                    x = y = np.nan
                at = 2 * (first + start + lane)
                out[at] = fx * x + skew * y + cx
                out[at + 1] = fy * y + cy
        first += num_points


@kernel
def through(numbers: Floats, at: int, x: float, y: float) -> tuple[float, float]:
    """Return a point through the homography that begins at a place; NaN for one behind it."""
    w = numbers[at + 6] * x + numbers[at + 7] * y + numbers[at + 8]
    w = w if w > 0 else np.nan
    return (
        (numbers[at] * x + numbers[at + 1] * y + numbers[at + 2]) / w,
        (numbers[at + 3] * x + numbers[at + 4] * y + numbers[at + 5]) / w,
    )


@kernel
def _find(radius: float, radii: Floats) -> tuple[int, float]:
    """Return where `numpy.interp` finds a radius: the last entry not above it, and a share."""
    place = 0
    step = TABLE_SIZE // 2
    while step > 0:
        place += step * (radii[place + step] <= radius)
        step //= 2
    if place == TABLE_SIZE - 1:
        return place, 0.0
    return place, (radius - radii[place]) / (radii[place + 1] - radii[place])


@kernel
def _solve_brown(numbers: Floats, table: Floats, lanes: Floats) -> None:
    """Take Newton steps in the plane."""
    k1, k2, p1, p2 = numbers[LENS], numbers[LENS + 1], numbers[LENS + 2], numbers[LENS + 3]
    k3, k4, k5, k6 = numbers[LENS + 4], numbers[LENS + 5], numbers[LENS + 6], numbers[LENS + 7]
    s1, s2, s3, s4 = numbers[LENS + 8], numbers[LENS + 9], numbers[LENS + 10], numbers[LENS + 11]
    pitch = numbers[LIMITS] / (TABLE_SIZE - 1)
    for lane in range(LANES):
        radius = lanes[2 * LANES + lane]
        place, share = _find(radius, table[0])
        # tan(a + b) from tan(a): b is below 0.0031, and its tangent these terms but for rounding
        b = share * pitch
        tangent = b * (1.0 + b * b * (1 / 3 + b * b * (2 / 15)))
        ratio = (table[1, place] + tangent) / (1.0 - table[1, place] * tangent)
        ratio /= radius if radius > 0 else 1.0
        lanes[3 * LANES + lane] = lanes[lane] * ratio
        lanes[4 * LANES + lane] = lanes[LANES + lane] * ratio
    for step in range(NEWTON_STEPS + 1):
        busy = 0
        for lane in range(LANES):
            x, y = lanes[3 * LANES + lane], lanes[4 * LANES + lane]
            squared = x * x + y * y
            inverse = 1.0 / (1.0 + squared * (k4 + squared * (k5 + squared * k6)))
            factor = inverse * (1.0 + squared * (k1 + squared * (k2 + squared * k3)))
            above_slope = k1 + squared * (2 * k2 + 3 * squared * k3)
            below_slope = k4 + squared * (2 * k5 + 3 * squared * k6)
            slope = inverse * (above_slope - factor * below_slope)
            prism_x, prism_y = 2 * (s1 + 2 * s2 * squared), 2 * (s3 + 2 * s4 * squared)
            both = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            xx = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
            yy = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
            xy, yx = both + prism_x * y, both + prism_y * x
            error_x = lanes[lane] - x * factor - 2 * p1 * x * y - p2 * (squared + 2 * x * x)
            error_y = lanes[LANES + lane] - y * factor - p1 * (squared + 2 * y * y) - 2 * p2 * x * y
            error_x -= squared * (s1 + s2 * squared)
            error_y -= squared * (s3 + s4 * squared)
            error = abs(error_x) if abs(error_x) > abs(error_y) else abs(error_y)
            scale = 1.0 / (xx * yy - xy * yx)
            go_on = error > SMALL_ERROR and step < NEWTON_STEPS
            busy |= go_on
            step_x = scale * (yy * error_x - xy * error_y)
            step_y = scale * (xx * error_y - yx * error_x)
            lanes[3 * LANES + lane] = x + step_x if go_on else x
            lanes[4 * LANES + lane] = y + step_y if go_on else y
            lanes[5 * LANES + lane] = error
        if not busy:
            break


@kernel
def _solve_fisheye(numbers: Floats, table: Floats, lanes: Floats) -> None:
    """Take Newton steps in the angle."""
    k1, k2, k3, k4 = numbers[LENS], numbers[LENS + 1], numbers[LENS + 2], numbers[LENS + 3]
    limit = numbers[LIMITS]
    for lane in range(LANES):
        place, share = _find(lanes[2 * LANES + lane], table[0])
        lanes[3 * LANES + lane] = (place + share) * (limit / (TABLE_SIZE - 1))
    for step in range(NEWTON_STEPS + 1):
        busy = 0
        for lane in range(LANES):
            angle = lanes[3 * LANES + lane]
            squared = angle * angle
            factor = 1.0 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4)))
            slope = 1.0 + squared * (
                3 * k1 + squared * (5 * k2 + squared * (7 * k3 + squared * 9 * k4))
            )
            error = lanes[2 * LANES + lane] - angle * factor
            go_on = abs(error) > SMALL_ERROR and step < NEWTON_STEPS
            busy |= go_on
            moved = angle + error / slope
            moved = 0.0 if moved < 0.0 else moved
            moved = limit if moved > limit else moved
            lanes[3 * LANES + lane] = moved if go_on else angle
            lanes[5 * LANES + lane] = abs(error)
        if not busy:
            break
    for lane in range(LANES):
        radius = lanes[2 * LANES + lane]
        ratio = math.tan(lanes[3 * LANES + lane]) / (radius if radius > 0 else 1.0)
        lanes[3 * LANES + lane] = lanes[lane] * ratio
        lanes[4 * LANES + lane] = lanes[LANES + lane] * ratio
