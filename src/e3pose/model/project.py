"""Project the people of a slot into all cameras: the loops of `Rig.project`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.model.camera import MIN_DEPTH_M, Rig
from e3pose.model.undistort import (
    FISHEYE,
    IDEAL,
    LENS,
    LIMITS,
    TILT,
    Lenses,
    make_lenses,
    through,
)  # fmt: skip


class Optics(NamedTuple):
    """The constants of a rig for projections into it."""

    rotations: Floats  # (num_cameras, 3, 3) world to camera
    translations: Floats  # (num_cameras, 3)
    intrinsics: Floats  # (num_cameras, 5) fx, skew, cx, fy, cy
    sizes: Floats  # (num_cameras, 2) width and height
    lenses: Lenses


def make_optics(rig: Rig) -> Optics:
    """Collect the optics of a rig."""
    return Optics(
        np.stack([camera.R for camera in rig.cameras]),
        np.stack([camera.t for camera in rig.cameras]),
        np.stack([camera.K[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]] for camera in rig.cameras]),
        rig.image_sizes,
        make_lenses(rig),
    )


@kernel
def project_people(camera: int, optics: Optics, points_m: Floats, pixels: Floats) -> None:
    """Fill `pixels` `(num_people, num_joints, 2)` of one camera; NaN where `Rig.project` has it.

    Args:
        camera: its index.
        optics: of the rig.
        points_m: `(num_people, num_joints, 3)` world metres, NaN where unknown.
        pixels: filled.
    """
    rotation, translation = optics.rotations[camera], optics.translations[camera]
    fx, skew, cx, fy, cy = optics.intrinsics[camera]
    model, numbers = optics.lenses.models[camera], optics.lenses.numbers[camera]
    place = np.empty(3)
    for person in range(points_m.shape[0]):
        for joint in range(points_m.shape[1]):
            for row in range(3):
                place[row] = translation[row]
                for axis in range(3):
                    place[row] += rotation[row, axis] * points_m[person, joint, axis]
            u = v = np.nan
            if place[2] >= MIN_DEPTH_M:
                x, y = distorted(model, numbers, place[0] / place[2], place[1] / place[2])
                u, v = fx * x + skew * y + cx, fy * y + cy
            known = math.isfinite(u) and math.isfinite(v)
            pixels[person, joint, 0] = u if known else np.nan
            pixels[person, joint, 1] = v if known else np.nan


@kernel
def distorted(model: int, numbers: Floats, x: float, y: float) -> tuple[float, float]:
    """Return where a lens puts an ideal point, as `Distortion.distort`; NaN beyond the fold.

    Arguments are those of `undistort.Lenses`, for one camera.
    """
    if model == IDEAL:
        return x, y
    squared = x * x + y * y
    radius = math.sqrt(squared)
    if not radius <= numbers[LIMITS + 1]:
        return np.nan, np.nan
    k1, k2, p1, p2 = numbers[LENS], numbers[LENS + 1], numbers[LENS + 2], numbers[LENS + 3]
    if model == FISHEYE:
        angle = math.atan(radius)
        a = angle * angle
        real = angle * (1.0 + a * (k1 + a * (k2 + a * (p1 + a * p2))))
        ratio = real / radius if radius > 0 else 1.0
        return x * ratio, y * ratio
    k3, k4, k5, k6 = numbers[LENS + 4], numbers[LENS + 5], numbers[LENS + 6], numbers[LENS + 7]
    factor = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
    factor /= 1.0 + squared * (k4 + squared * (k5 + squared * k6))
    s1, s2, s3, s4 = numbers[LENS + 8], numbers[LENS + 9], numbers[LENS + 10], numbers[LENS + 11]
    real_x = x * factor + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
    real_y = y * factor + p1 * (squared + 2 * y * y) + 2 * p2 * x * y
    real_x += squared * (s1 + s2 * squared)
    real_y += squared * (s3 + s4 * squared)
    return through(numbers, TILT, real_x, real_y)
