"""A recording of one person whom every camera sees exactly, so that every number is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tests.rigs import around

from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries


def one_person(angles: Sequence[float], num_slots: int, truth: bool = True) -> Recording:
    """Return the person between cameras that stand at `angles`, radians, on a circle of 4 m."""
    rig = around(angles, 4.0, 1.5)
    body = np.random.default_rng(0).normal(scale=[0.2, 0.2, 0.4], size=(17, 3)) + [0, 0, 1]
    joints_m = np.stack([[body + [0.01 * slot, 0, 0]] for slot in range(num_slots)])
    series = tuple(
        ViewSeries.from_views(
            [Poses2D(camera.project(people), np.ones((1, 17))) for people in joints_m],
            range(num_slots),
            (np.arange(num_slots) / 25).tolist(),
            17,
        )
        for camera in rig.cameras
    )
    return Recording(
        "one person", rig, 25.0, num_slots, COCO17, series,
        truth=Truth(COCO17, ("anna",), joints_m) if truth else None,
    )  # fmt: skip
