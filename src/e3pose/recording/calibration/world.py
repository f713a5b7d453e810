"""Check that a rig has extrinsics, z up and metres, with advice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.model.camera import Camera, Rig

UP_SHARE = 0.3  # mean of the images' up directions along world z, from which a rig is upright
UP = {  # of people, in the axes of a camera, by the degrees clockwise that make them upright
    degrees: np.array(axis, dtype=np.float64)
    for degrees, axis in {0: (0, -1, 0), 90: (-1, 0, 0), 180: (0, 1, 0), 270: (1, 0, 0)}.items()
}
DOWNWARD = 0.7  # mean share of the view downwards, from which cameras hang at a ceiling
SPAN_M = (0.2, 200.0)  # largest distance between two cameras
FLOOR_M = -0.3  # half of the cameras below this are under the floor
ASSUMED_FOCAL = 0.85  # of the longer side: 61 degrees, between webcams and phones


def assumed_rig(image_sizes: Mapping[str, tuple[int, int]], focal: float = ASSUMED_FOCAL) -> Rig:
    """Return cameras of which the image size alone is known: lenses assumed, places unknown.

    Args:
        image_sizes: `(width, height)` in pixels by camera id.
        focal: length of all, in longer sides of the image.
    """
    cameras = []
    for camera_id, (width, height) in image_sizes.items():
        focal_px = focal * max(width, height)
        K = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
        cameras.append(Camera(camera_id, (width, height), K, np.eye(4), lens_assumed=True))
    return Rig(tuple(cameras), placed=False)


def require_placed(rig: Rig, where: object) -> None:
    """Raise `InputError` with the command that helps, unless it is known where cameras stand.

    Args:
        rig: the cameras.
        where: the file or recording that they are from.
    """
    if not rig.placed:
        which = f"camera {', '.join(rig.unplaced)} stands" if rig.unplaced else "the cameras stand"
        raise InputError(
            f"{where}: it is not known where {which}, expected a calibration: "
            f"e3pose calibrate extrinsics {shell(where)} rig.toml --height 171cm "
            "(docs/how-to/calibrate-cameras.md)"
        )


def world_problem(
    rig: Rig, file: object = "calibration.toml", rotations: Mapping[str, int] | None = None
) -> tuple[str, str]:
    """Return a short stable name and a description of a problem with a rig's axes or unit.

    Args:
        rig: the cameras; a rig that is not placed has no such problem.
        file: the calibration, for the command that mends it.
        rotations: by camera, degrees clockwise that make people in its images upright.

    Returns:
        Two empty strings if nothing is wrong.
    """
    if not rig.placed:
        return "", ""
    centers = rig.centers_m
    if len(rig) > 1:
        span_m = float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())
        if not SPAN_M[0] <= span_m <= SPAN_M[1]:
            return "rig-span", (
                f"cameras are at most {span_m:.3g} m apart; is the calibration in metres? "
                '(a TOML file can say [metadata] units = "mm")'
            )
    degrees = rotations or {}
    up = np.mean(
        [UP[degrees.get(camera.camera_id, 0)] @ camera.R for camera in rig.cameras], axis=0
    )
    ahead = np.mean([camera.R[2] for camera in rig.cameras], axis=0)
    if up[2] < UP_SHARE and ahead[2] > -DOWNWARD:
        axis = int(np.argmax(np.abs(up)))
        name = ("-" if up[axis] < 0 else "") + "xyz"[axis]
        return "not-z-up", (
            f"the images' up points {up[2]:+.2f} along world z on average, expected near 1; "
            f"it points along {name}: e3pose calibrate align {shell(file)} fixed.toml --up={name}"
        )
    if np.median(centers[:, 2]) < FLOOR_M:
        return "below-floor", (
            f"most cameras stand below the floor (z = {np.median(centers[:, 2]):.2f} m); "
            "e3pose calibrate align puts the floor at 0"
        )
    return "", ""
