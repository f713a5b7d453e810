"""Compile and load everything before the first slot."""

from __future__ import annotations

import numpy as np

from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline, initial_state, step


def warm_up(pipeline: Pipeline) -> None:
    """Run a few synthetic slots through the loop, and discard them."""
    joints = np.zeros((2, 2, pipeline.num_joints, 3))
    pipeline.predictor.predict(joints, pipeline.interval_s, pipeline.lead_slots)
    if pipeline.steering is not None:
        pipeline.steering.predict(joints, pipeline.interval_s, pipeline.lead_slots)
    state = initial_state(pipeline)
    everybody = np.ones(len(pipeline.rig), dtype=bool)
    for _ in range(3):
        views = {
            camera: Poses2D(
                np.zeros((1, pipeline.num_joints, 2)), np.ones((1, pipeline.num_joints))
            )
            for camera in range(len(pipeline.rig))
        }
        state, _record = step(pipeline, state, views, everybody)
