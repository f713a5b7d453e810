"""What is odd about the axes of a rig."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from tests.cases import each_case
from tests.rigs import looking

from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration.world import world_problem

UPRIGHT = looking((4, 0), (0, 4), (-4, 0))


def rolled(degrees: int) -> Rig:
    """Return cameras whose images must be turned by this much, clockwise, to be upright."""
    # Image x is right and y is down, so that a positive angle about z turns the image clockwise.
    back = Rotation.from_euler("z", -degrees, degrees=True).as_matrix()
    cameras = []
    for camera in UPRIGHT.cameras:
        size = camera.image_size[::-1] if degrees in (90, 270) else camera.image_size
        cameras.append(
            Camera.from_world_to_camera(
                camera.camera_id, size, camera.K, back @ camera.R, back @ camera.t
            )
        )
    return Rig(tuple(cameras))


@each_case("degrees", [90, 180, 270])
def test_cameras_on_their_side_are_upright_once_turned(degrees: int) -> None:
    rig = rolled(degrees)
    point_m = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.5]])
    low_px, high_px = rig.cameras[0].project(point_m)
    towards = {90: (-1, 0), 180: (0, 1), 270: (1, 0)}[degrees]  # of the image, where heads are
    assert (high_px - low_px) @ towards > 0.9 * np.linalg.norm(high_px - low_px)
    assert world_problem(rig)[0] == "not-z-up"
    assert world_problem(rig, rotations=dict.fromkeys(rig.camera_ids, degrees)) == ("", "")


def test_upright_cameras_are_not_upright_if_they_are_said_to_be_turned() -> None:
    assert world_problem(UPRIGHT) == ("", "")
    assert world_problem(UPRIGHT, rotations=dict.fromkeys(UPRIGHT.camera_ids, 180))[0] == "not-z-up"
