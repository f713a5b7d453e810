"""Compile and load everything before the first slot.

The predictor's kernels are a third of the work: they are compiled in a process of their own
meanwhile, where there is a second core and memory for it. Compiled code reaches this one through
the cache on disk.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from e3pose.base.kernel import is_cached
from e3pose.base.system import free_bytes, num_cores
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import SKELETONS
from e3pose.pipeline import Pipeline, initial_state, step
from e3pose.predict.attention_lstm import AttentionLstm

HELPER_BYTES = 1.5e9  # free memory from which a second process compiles
SLOTS = 12  # until a person is followed, selected for, and foreseen
# Somebody who stands: height and, of left joints, distance from the middle, metres.
STANDING_M = {
    "hip": (0.93, 0.1), "knee": (0.51, 0.1), "ankle": (0.1, 0.1), "heel": (0.03, 0.1),
    "toe": (0.02, 0.1), "foot": (0.02, 0.1), "shoulder": (1.42, 0.17), "elbow": (1.14, 0.19),
    "wrist": (0.9, 0.2), "hand": (0.85, 0.2), "ear": (1.6, 0.07), "eye": (1.62, 0.03),
}  # fmt: skip
OTHERS_M = (1.5, 0.05)


def warm_up(
    pipeline: Pipeline, joints: Sequence[str], more: Callable[[], None] = lambda: None
) -> None:
    """Run a few synthetic slots through the loop and discard them; then call `more`.

    Args:
        pipeline: the loop.
        joints: names of the skeleton's joints.
        more: what else is to be compiled.
    """
    state = initial_state(pipeline)
    helper = _start_helper(pipeline)
    if helper is not None:
        try:
            pipeline.estimator.estimate(state.memory, {}, 0.0, pipeline.clock)
            helper.wait()
        finally:
            helper.terminate()
    histories_m = np.zeros((2, 2, pipeline.num_joints, 3))
    pipeline.predictor.predict(histories_m, pipeline.interval_s, pipeline.lead_slots)
    if pipeline.steering is not None:
        pipeline.steering.predict(histories_m, pipeline.interval_s, pipeline.lead_slots)
    everybody = np.ones(len(pipeline.rig), dtype=bool)
    views = _seen(pipeline.rig, joints)
    selecting = replace(pipeline, warmup_slots=0)  # the policy as well
    for _ in range(SLOTS):
        state, _record = step(selecting, state, views, everybody)
    more()


def _seen(rig: Rig, joints: Sequence[str]) -> dict[int, Poses2D]:
    """Synthetic views for warm-up: one person before all cameras, one before the first alone."""
    axes = np.stack([camera.R[2] for camera in rig.cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    sums = across.sum(axis=0), np.einsum("cij,cj->i", across, rig.centers_m)
    middle_m = np.linalg.lstsq(*sums, rcond=None)[0]  # the point nearest to all optical axes
    body_m = np.array([_standing_m(joint) for joint in joints]) - [0.0, 0.0, 0.9]
    people_m = middle_m + np.stack([body_m, body_m + np.array([1.0, 0.5, 0.0])])
    pixels = rig.project(people_m)
    scores = np.asarray(np.isfinite(pixels).all(axis=-1), dtype=np.float64)
    return {
        camera: Poses2D(pixels[camera, :people], scores[camera, :people])
        for camera, people in enumerate([2] + [1] * (len(rig) - 1))
    }


def _standing_m(joint: str) -> tuple[float, float, float]:
    height_m, aside_m = next((m for part, m in STANDING_M.items() if part in joint), OTHERS_M)
    side = {"left": 1.0, "right": -1.0}.get(joint.partition("_")[0], 0.0)
    return side * aside_m, 0.02, height_m


def compile_prediction() -> None:
    """Compile the kernels of the learned predictor."""
    skeleton = SKELETONS["coco17"]
    AttentionLstm(skeleton).predict(np.zeros((2, 2, len(skeleton), 3)), 0.04, 2)


def _start_helper(pipeline: Pipeline) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles for the predictor; None if it does not help."""
    from e3pose.predict.kernels.prediction import predict_tracks

    predictors = (pipeline.predictor, pipeline.steering)
    if not any(isinstance(predictor, AttentionLstm) for predictor in predictors):
        return None
    if is_cached(predict_tracks) is not False or num_cores() < 2 or free_bytes() < HELPER_BYTES:
        return None
    command = [sys.executable, "-m", "e3pose.edge.precompile"]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    compile_prediction()
