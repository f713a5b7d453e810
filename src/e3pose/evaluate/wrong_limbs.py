"""Wrong limbs: limbs that a viewer would point at. Pure.

A limb is wrong if its direction is more than `TURNED` off, or its far end more than `FAR_M`. The
limbs are upper arms, forearms, thighs and shins, each named by the joint at its far end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera
from e3pose.model.skeleton import BODY_LIMBS

LIMBS = BODY_LIMBS[4:]  # without the trunk
TURNED = math.radians(30)  # definition
FAR_M = 0.15  # definition


def wrong_by_truth(joints_m: Floats, true_m: Floats, names: Sequence[str]) -> Floats:
    """Return which limbs of people are wrong.

    Args:
        joints_m: `(*batch, num_joints, 3)` metres, NaN where missing.
        true_m: `(*batch, num_joints, 3)` the same people as they were.
        names: of the joints.

    Returns:
        `(*batch, num_joints)`: 1 where the limb that ends in a joint is wrong, 0 where it is right,
        NaN where there is no such limb or one of its ends is missing.
    """
    starts, ends = _rows(names)
    limb_m, true_limb_m = (each[..., ends, :] - each[..., starts, :] for each in (joints_m, true_m))
    along = (limb_m * true_limb_m).sum(axis=-1)
    lengths_m2 = np.linalg.norm(limb_m, axis=-1) * np.linalg.norm(true_limb_m, axis=-1)
    far = np.linalg.norm((joints_m - true_m)[..., ends, :], axis=-1) > FAR_M
    wrong = far | (along < math.cos(TURNED) * lengths_m2)
    return _by_joint(np.where(np.isfinite(along), wrong, np.nan), ends, names)


def wrong_in_view(
    camera: Camera, joints_m: Floats, keypoints_px: Floats, names: Sequence[str]
) -> Floats:
    """Return which limbs of people are wrong in an image.

    There a limb is turned if its end, as seen from its start, is as far from where the keypoints
    have it as the end of a limb of its length that is seen from the side and turned by `TURNED`.
    Ends are far off by their distance across the ray.

    Args:
        camera: of the image.
        joints_m: `(*batch, num_joints, 3)` metres, NaN where missing.
        keypoints_px: `(*batch, num_joints, 2)` as detected, distorted; NaN where not seen.
        names: of the joints.

    Returns:
        As `wrong_by_truth`.
    """
    starts, ends = _rows(names)
    focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    px_per_m = focal_px / (joints_m[..., ends, :] @ camera.R[2] + camera.t[2])
    limb_m = np.linalg.norm(joints_m[..., ends, :] - joints_m[..., starts, :], axis=-1)
    off_px = camera.project(joints_m) - keypoints_px
    end_px = np.linalg.norm(off_px[..., ends, :], axis=-1)
    apart_px = np.linalg.norm(off_px[..., ends, :] - off_px[..., starts, :], axis=-1)
    turned = apart_px > 2 * math.sin(TURNED / 2) * limb_m * px_per_m
    wrong = turned | (end_px > FAR_M * px_per_m)
    return _by_joint(np.where(np.isfinite(apart_px), wrong, np.nan), ends, names)


def wrong_percent(wrong: NDArray[Any]) -> float | None:
    """Return the percentage of known limbs that are wrong; None without any."""
    known = wrong[np.isfinite(wrong)]
    return 100 * float(known.mean(dtype=np.float64)) if len(known) else None


def _rows(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return the joints at the near and the far ends of the limbs that there are."""
    pairs = [(names.index(a), names.index(b)) for a, b in LIMBS if {a, b} <= set(names)]
    return [start for start, _ in pairs], [end for _, end in pairs]


def _by_joint(wrong: Floats, ends: Sequence[int], names: Sequence[str]) -> Floats:
    found = np.full((*wrong.shape[:-1], len(names)), np.nan)
    found[..., ends] = wrong
    return found
