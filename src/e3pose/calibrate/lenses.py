"""Priors on unknown lenses: one focal length for cameras of one kind.

Errors of a detector follow what it sees and so repeat: an observation counts for a fraction of one
when lenses are compared, else cameras of one kind would never seem alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.calibrate.bundle import Adjusted
from e3pose.calibrate.moved_cameras import NUM_LENS
from e3pose.model.camera import Rig
from e3pose.recording.calibration.world import ASSUMED_FOCAL

FOCAL_SIGMA = 0.35  # of the logarithm, round what is assumed
KIND_SIGMA = 0.01  # the same between cameras of one kind: lenses focused at other distances
MIDDLE_SIGMA = 0.02  # of the longer side: how far a principal point is from the image's middle
DISTORTION_SIGMA, KIND_DISTORTION_SIGMA = 0.15, 0.02  # of k1
REPEATED = 100.0  # observations that count as one, because their errors repeat
MOST_RISE = 0.007  # of the mean robust square, by which one focal length may fit worse than two


def expected_lenses(rig: Rig, kinds: NDArray[np.int64] | None = None) -> Floats | None:
    """Return `(num_cameras, 4, num_cameras, 4)` covariance of assumed lenses; None without any.

    Args:
        rig: the cameras.
        kinds: `(num_cameras,)` cameras of one number share a focal length; None for none.
    """
    unknown = np.array([camera.lens_assumed for camera in rig.cameras])
    if not unknown.any():
        return None
    number = len(rig)
    both = unknown[:, None] & unknown
    kinds = np.arange(number) if kinds is None else kinds
    same = (kinds[:, None] == kinds) & both
    covariance = np.zeros((number, NUM_LENS, number, NUM_LENS))
    each = np.eye(number) * both
    covariance[:, 0, :, 0] = FOCAL_SIGMA**2 * same + KIND_SIGMA**2 * each
    covariance[:, 1, :, 1] = DISTORTION_SIGMA**2 * both + KIND_DISTORTION_SIGMA**2 * each
    return covariance


def final_lenses(rig: Rig, kinds: NDArray[np.int64]) -> Floats | None:
    """Return `expected_lenses` with principal points, as they weigh against errors that repeat."""
    covariance = expected_lenses(rig, kinds)
    if covariance is None:
        return None
    unknown = np.flatnonzero([camera.lens_assumed for camera in rig.cameras])
    for axis in (2, 3):
        covariance[unknown, axis, unknown, axis] = (MIDDLE_SIGMA / ASSUMED_FOCAL) ** 2
    return covariance / REPEATED


def kinds_of(adjusted: Adjusted, factor: float) -> NDArray[np.int64]:
    """Group cameras of one image size whose focal lengths do not differ beyond doubt.

    Args:
        adjusted: a rig of which each lens was found by itself, or by kinds.
        factor: how many times as large as stated errors are.

    Returns:
        `(num_cameras,)` a number for each kind.
    """
    cameras = adjusted.rig.cameras
    widths = [camera.K[0, 0] / max(camera.image_size) for camera in cameras]
    log_focal: Floats = np.asarray(np.log(widths), dtype=np.float64)
    kinds = np.arange(len(cameras))
    unknown = np.array([camera.lens_assumed for camera in cameras])
    if not unknown.any():
        return kinds
    covariance = adjusted.covariance[:, 6, :, 6] + (1e-8 + (~unknown)) * np.eye(len(cameras))
    precision: Floats = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    observations = int(np.isfinite(adjusted.residuals[..., 0]).sum())
    most = 2 * MOST_RISE * factor**2 * observations
    while True:
        best: tuple[float, NDArray[np.int64]] | None = None
        for a in np.unique(kinds).tolist():
            for b in np.unique(kinds[kinds > a]).tolist():
                first, second = int(np.argmax(kinds == a)), int(np.argmax(kinds == b))
                if not (unknown[first] and unknown[second]):
                    continue
                if cameras[first].image_size != cameras[second].image_size:
                    continue
                joined = np.where(kinds == b, a, kinds)
                # The weighted square of focal lengths about one for each kind.
                design = (joined[:, None] == np.unique(joined)).astype(np.float64)
                means = np.linalg.solve(
                    design.T @ precision @ design, design.T @ precision @ log_focal
                )
                off = log_focal - design @ means
                rise = float(off @ precision @ off)
                if best is None or rise < best[0]:
                    best = rise, joined
        if best is None or best[0] > most:
            return kinds
        kinds = best[1]
