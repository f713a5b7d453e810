"""Calibrate a rig with another program, in whose environment this runs; no e3pose in it.

    OTHER-PYTHON lab/benchmarks/calibration_others.py caliscope|aniposelib POINTS.npz

`POINTS.npz` has `keypoints_px` (num_cameras, num_points, 2) with NaN where not seen, `slot` and
`joint` (num_points,), `sizes`, `K`, `distortions`, whether lenses are `known`, and where cameras
are thought to be: `R` and `t` (world to camera).
Prints the extrinsics that were found as JSON: a list of `R` and `t`.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from typing import Any

import numpy as np


def caliscope(data: Any) -> list[dict[str, Any]]:
    """Begin from nothing, as it does without a board; lenses must be known."""
    import pandas as pd
    from caliscope.api import CameraArray, CameraData, CaptureVolume
    from caliscope.core.point_data import ImagePoints

    pixels, rows = data["keypoints_px"], []
    for camera in range(len(pixels)):
        seen = np.flatnonzero(np.isfinite(pixels[camera, :, 0]))
        rows.append(
            pd.DataFrame({
                "sync_index": data["slot"][seen], "cam_id": camera, "object_id": 0,
                "keypoint_id": data["joint"][seen],
                "img_loc_x": pixels[camera, seen, 0], "img_loc_y": pixels[camera, seen, 1],
            })
        )  # fmt: skip
    cameras = {
        i: CameraData(
            cam_id=i, size=tuple(int(n) for n in data["sizes"][i]), matrix=data["K"][i],
            distortions=data["distortions"][i],
        )
        for i in range(len(pixels))
    }  # fmt: skip
    volume = CaptureVolume.bootstrap(ImagePoints(pd.concat(rows)), CameraArray(cameras))
    volume = volume.optimize().filter_by_percentile_error(2.5).optimize()
    found = volume.camera_array.cameras
    return [
        {"R": np.asarray(found[i].rotation).tolist(), "t": np.ravel(found[i].translation).tolist()}
        for i in range(len(pixels))
    ]


def aniposelib(data: Any) -> list[dict[str, Any]]:
    """Refine the start that it is given, with focal lengths and k1 where lenses are unknown."""
    import cv2
    from aniposelib.cameras import Camera, CameraGroup

    group = CameraGroup([
        Camera(
            matrix=data["K"][i], dist=data["distortions"][i], size=data["sizes"][i].tolist(),
            rvec=cv2.Rodrigues(data["R"][i])[0].ravel(), tvec=data["t"][i], name=str(i),
        )
        for i in range(len(data["K"]))
    ])  # fmt: skip
    np.random.seed(7)  # noqa: NPY002  # what aniposelib samples with
    group.bundle_adjust_iter(data["keypoints_px"], only_extrinsics=bool(data["known"]))
    return [
        {
            "R": cv2.Rodrigues(camera.get_rotation())[0].tolist(),
            "t": camera.get_translation().tolist(),
        }
        for camera in group.cameras
    ]  # fmt: skip


if __name__ == "__main__":
    tool = {"caliscope": caliscope, "aniposelib": aniposelib}[sys.argv[1]]
    with contextlib.redirect_stdout(io.StringIO()):
        found = tool(np.load(sys.argv[2]))
    print(json.dumps(found))
