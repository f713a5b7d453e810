"""Compile and load everything before the first slot.

The predictor's kernels are a third of the work: they are compiled in a process of their own
meanwhile, where there is a second core and memory for it. Compiled code reaches this one through
the cache on disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np

from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import SKELETONS
from e3pose.pipeline import Pipeline, initial_state, step

HELPER_BYTES = 1.5e9  # free memory from which a second process compiles


def warm_up(pipeline: Pipeline, more: Callable[[], None] = lambda: None) -> None:
    """Run a few synthetic slots through the loop, and discard them; then do what is `more`."""
    state = initial_state(pipeline)
    helper = _start_helper(pipeline)
    if helper is not None:
        try:
            pipeline.estimator.estimate(state.memory, {}, 0.0, pipeline.clock)
            helper.wait()
        finally:
            helper.terminate()
    joints = np.zeros((2, 2, pipeline.num_joints, 3))
    pipeline.predictor.predict(joints, pipeline.interval_s, pipeline.lead_slots)
    if pipeline.steering is not None:
        pipeline.steering.predict(joints, pipeline.interval_s, pipeline.lead_slots)
    everybody = np.ones(len(pipeline.rig), dtype=bool)
    for _ in range(3):
        views = {
            camera: Poses2D(
                np.zeros((1, pipeline.num_joints, 2)), np.ones((1, pipeline.num_joints))
            )
            for camera in range(len(pipeline.rig))
        }
        state, _record = step(pipeline, state, views, everybody)
    more()


def compiling_left_s() -> float:
    """Return the seconds until all kernels are compiled; 0 while that is unknown.

    It imports nothing: another thread may be importing numba just now.
    """
    compiling = getattr(sys.modules.get("e3pose.runtime.compiling"), "COMPILING", None)
    return (compiling.left_s() or 0.0) if compiling is not None and compiling.begun else 0.0


def compile_prediction() -> None:
    """Compile what the learned predictor needs."""
    from e3pose.predict.attention_lstm import AttentionLstm

    skeleton = SKELETONS["coco17"]
    AttentionLstm(skeleton).predict(np.zeros((2, 2, len(skeleton), 3)), 0.04, 2)


def _start_helper(pipeline: Pipeline) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles for the predictor; None where that does not help."""
    from e3pose.predict.attention_lstm import AttentionLstm
    from e3pose.predict.kernels.prediction import predict_tracks
    from e3pose.runtime.kernel import is_cached

    predictors = (pipeline.predictor, pipeline.steering)
    if not any(isinstance(predictor, AttentionLstm) for predictor in predictors):
        return None
    if is_cached(predict_tracks) is not False or not _has_room():
        return None
    command = [sys.executable, "-m", "e3pose.edge.precompile"]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def _has_room() -> bool:
    """Return whether this machine has a second core, and memory for a second process."""
    try:
        free_bytes = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return len(os.sched_getaffinity(0)) > 1 and free_bytes >= HELPER_BYTES
    except (AttributeError, ValueError, OSError):  # another system than Linux
        return (os.cpu_count() or 1) > 1


if __name__ == "__main__":
    compile_prediction()
