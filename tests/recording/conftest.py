from __future__ import annotations

import numpy as np
import pytest

from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries

NUM_SLOTS = 40
FPS = 20.0


def _camera(camera_id: str, angle: float) -> Camera:
    """A camera on a ring of 4 m, 2 m up, that looks at the middle of the room, z up."""
    center = np.array([4 * np.cos(angle), 4 * np.sin(angle), 2.0])
    forward = np.array([0.0, 0.0, 1.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]
    return Camera.from_world_to_camera(camera_id, (1280, 720), K, rotation, -rotation @ center)


@pytest.fixture(scope="session")
def scene() -> Recording:
    """Two people who walk past each other, seen by four cameras without error; nothing is wrong."""
    rig = Rig(tuple(_camera(f"cam{n}", angle) for n, angle in enumerate((0.1, 1.6, 3.3, 4.6))))
    rng = np.random.default_rng(5)
    body = rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.8], (2, 17, 3))
    path = np.linspace(
        [[-1.0, 0.5, 0], [1.0, -0.5, 0]], [[1.0, 0.5, 0], [-1.0, -0.5, 0]], NUM_SLOTS
    )
    joints_m = body[None] + path[:, :, None]
    views = []
    for camera in rig.cameras:
        pixels = camera.project(joints_m)
        scores = rng.uniform(0.5, 1.0, pixels.shape[:3])
        frames = [Poses2D(*frame) for frame in zip(pixels, scores, strict=True)]
        times_s = [slot / FPS for slot in range(NUM_SLOTS)]
        views.append(ViewSeries.from_views(frames, range(NUM_SLOTS), times_s, 17))
    truth = Truth(COCO17, ("ann", "bob"), joints_m)
    return Recording("a room", rig, FPS, NUM_SLOTS, COCO17, tuple(views), truth, source="made up")
