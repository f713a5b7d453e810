"""Check where cameras are, and whether they see the same."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.settings.resolved import ResolvedSite, calibrate_advice
from e3pose.site.check.finding import Finding

APART_M = 0.1  # cameras nearer to each other than this see the same


def uncalibrated(site: ResolvedSite) -> Finding:
    """Return the finding of a site without camera positions."""
    file = site.file.calibration
    found = f"{file} has lenses, but no places" if file.exists() else f"{file} is missing"
    return Finding("problem", "calibration", found, calibrate_advice(site.file))


def check_calibration(rig: Rig) -> Iterator[Finding]:
    """Check where the cameras are, and whether they see the same."""
    centres = np.array([camera.T_world_camera[:3, 3] for camera in rig.cameras])
    axes = np.array([camera.T_world_camera[:3, 2] for camera in rig.cameras])
    yield Finding("ok", "calibration", plural(len(rig), "camera"))
    if len(rig) < 2:
        yield Finding("problem", "calibration", "one camera", "3D needs at least two cameras")
        return
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    for a, b in np.argwhere(np.triu(distance < APART_M)).tolist():
        yield Finding(
            "warning",
            "calibration",
            f"{rig.camera_ids[a]} and {rig.camera_ids[b]} are {distance[a, b] * 100:.0f} cm apart",
            "cameras in one place share one view; check the calibration",
        )
    spread = float(np.ptp(centres, axis=0).max())
    if spread > 200:
        yield Finding(
            "problem",
            "calibration",
            f"cameras are {spread:.0f} m apart",
            "the calibration is probably in millimetres or centimetres; set its units",
        )
    sees = _seen_by(rig, centres, axes)
    for camera_id, others in zip(rig.camera_ids, sees.tolist(), strict=True):
        if others == 0:
            yield Finding(
                "warning",
                "calibration",
                f"{camera_id} does not overlap with any other camera",
                "check its extrinsics; people seen by one camera only get no 3D pose",
            )
    up = centres[:, 2]
    if (up < -0.5).any():
        low = [i for i, z in zip(rig.camera_ids, up.tolist(), strict=True) if z < -0.5]
        yield Finding(
            "warning",
            "calibration",
            f"{', '.join(low)} below the floor",
            "z must point up, with the floor at z = 0",
        )


def _seen_by(rig: Rig, centres: Floats, axes: Floats) -> NDArray[np.int64]:
    """Return `(num_cameras,)`: cameras that see a point that this one sees, 2 to 8 m ahead."""
    depth = np.linspace(2.0, 8.0, 13)[:, None, None]
    points = centres + depth * axes  # (num_depths, num_cameras, 3)
    counts = np.zeros(len(rig), dtype=np.int64)
    for index, camera in enumerate(rig.cameras):
        pixels, ahead = camera.project(points), (points - centres[index]) @ axes[index] > 0.1
        inside = ((pixels >= 0) & (pixels < np.array(camera.image_size))).all(axis=-1) & ahead
        seen = inside.any(axis=0)
        seen[index] = False
        counts += seen
    return counts
