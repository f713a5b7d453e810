"""Recalibrate one camera by people while the others stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.bundle import AdjustOptions, adjust_points, root_mean_square
from e3pose.calibrate.from_people import (
    FINAL_POINTS,
    FINE_SIGMAS,
    ROUGH_SIGMAS,
)
from e3pose.calibrate.from_points import OUTLIER_SIGMAS, subsampled
from e3pose.calibrate.matched_people import match_people
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.model.rotations import angles_between
from e3pose.recording.record import Recording

MIN_POINTS = 200  # joints that the camera shares with others
MIN_OTHERS = 2  # cameras that it shares some with: one alone does not say how far away it is
MIN_INLIERS = 0.5  # of its keypoints, within three standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class OneCamera:
    """A rig with one camera recalibrated.

    Attributes:
        rig: all cameras.
        degrees: by how much the camera was turned.
        metres: by how much it was moved.
        error_px: its root mean square reprojection error of what agrees.
        inliers: share of its keypoints that agree.
        points: how many joints it shares with others.
    """

    rig: Rig
    degrees: float
    metres: float
    error_px: float
    inliers: float
    points: int


def place_one(recording: Recording, noise: Noise, rig: Rig, camera_id: str) -> OneCamera:
    """Place a camera that was knocked, by some 10 degrees and half a metre at most.

    Args:
        recording: people, seen since then.
        noise: what scores promise.
        rig: the calibration from before; lenses too.
        camera_id: which camera.

    Raises:
        InputError: when the people do not fix it.
    """
    index = rig.index(camera_id)
    if len(rig) < MIN_OTHERS + 1:
        raise InputError(f"--only: found {len(rig)} cameras, expected at least three")
    free = np.arange(len(rig)) == index
    current = rig
    for tolerance in (*ROUGH_SIGMAS, *FINE_SIGMAS):
        joints = match_people(recording, noise, current, tolerance)
        pixels, sigma = joints.keypoints_px, joints.sigma_px
        points = place_points(current, pixels, sigma)
        seen = np.isfinite(pixels[..., 0])
        used = np.flatnonzero(np.isfinite(points[:, 0]) & seen[index] & (seen.sum(axis=0) >= 2))
        others = (seen[:, used].sum(axis=1) >= MIN_POINTS / 4) & ~free
        if len(used) < MIN_POINTS or others.sum() < MIN_OTHERS:
            raise InputError(
                f"camera {camera_id}: shares {len(used)} joints with {others.sum()} cameras, "
                f"expected at least {MIN_POINTS} with {MIN_OTHERS}: record a person who "
                "walks through its view"
            )
        used = subsampled(used, seen[:, used].sum(axis=0), FINAL_POINTS)
        adjusted = adjust_points(
            current,
            points[used],
            pixels[:, used],
            sigma[:, used],
            AdjustOptions(OUTLIER_SIGMAS, free),
        )
        cameras = list(rig.cameras)
        cameras[index] = adjusted.rig.cameras[index]
        current = Rig(tuple(cameras))
    size = np.linalg.norm(adjusted.residuals[index, :, 0], axis=-1)
    inliers = float((size < 3.0).mean())
    if inliers < MIN_INLIERS:
        raise InputError(
            f"camera {camera_id}: only {100 * inliers:.0f} % of its keypoints agree with the other "
            "cameras: it moved too far for this, or another camera moved too; recalibrate all "
            "cameras with `e3pose calibrate extrinsics RECORDING rig.toml`"
        )
    before, after = rig.cameras[index], current.cameras[index]
    error_px = root_mean_square(np.where(size < 3.0, size * sigma[index, used], np.nan), 0)
    return OneCamera(
        current,
        float(np.degrees(angles_between(after.R[None], before.R[None])[0])),
        float(np.linalg.norm(after.center_m - before.center_m)),
        float(error_px),
        inliers,
        len(used),
    )
