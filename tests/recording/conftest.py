from __future__ import annotations

import numpy as np
import pytest
from tests.rigs import on_circle, towards

from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries

NUM_SLOTS = 40
FPS = 20.0


@pytest.fixture(scope="session")
def scene() -> Recording:
    """Two people who walk past each other, seen by four cameras without error; nothing is wrong."""
    places = (on_circle(4.0, 2.0, angle) for angle in (0.1, 1.6, 3.3, 4.6))
    rig = Rig(tuple(towards(f"cam{n}", at, size=(1280, 720)) for n, at in enumerate(places)))
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
