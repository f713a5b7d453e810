"""Compile and load everything before the first slot, or beside the first ones.

A first start compiles for about a minute. A process of its own does that, and leaves compiled code
in the cache on disk. Meanwhile the edge interprets its kernels: a few slots a second, with all
cameras, and no more than poses need. The network would take seconds, so that nobody is steered.
"""

from __future__ import annotations

import logging
import pickle
import re
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.base.child_process import start_call
from e3pose.base.compiling import COMPILING
from e3pose.base.kernel import is_cached
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import step_slot
from e3pose.estimate.smooth.delayed import Delayed
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline, initial_state, step
from e3pose.predict.velocities import ConstantVelocity

SLOTS = 12  # until a person is followed, selected for, and foreseen
# Somebody who stands: height and, of left joints, distance from the middle, metres.
STANDING_M = {
    "hip": (0.93, 0.1), "knee": (0.51, 0.1), "ankle": (0.1, 0.1), "heel": (0.03, 0.1),
    "toe": (0.02, 0.1), "foot": (0.02, 0.1), "shoulder": (1.42, 0.17), "elbow": (1.14, 0.19),
    "wrist": (0.9, 0.2), "hand": (0.85, 0.2), "ear": (1.6, 0.07), "eye": (1.62, 0.03),
}  # fmt: skip
OTHERS_M = (1.5, 0.05)


def warm_up(pipeline: Pipeline, joints: Sequence[str], delayed: Delayed | None = None) -> None:
    """Run a few synthetic slots through the loop and discard them.

    Args:
        pipeline: the loop.
        joints: names of the skeleton's joints.
        delayed: what smooths slots for later, too.
    """
    state = initial_state(pipeline)
    histories_m = np.zeros((2, 2, pipeline.num_joints, 3))
    pipeline.predictor.predict(histories_m, pipeline.interval_s, pipeline.lead_slots)
    if pipeline.steering is not None:
        pipeline.steering.predict(histories_m, pipeline.interval_s, pipeline.lead_slots)
    everybody = np.ones(len(pipeline.rig), dtype=bool)
    views = _seen(pipeline.rig, joints)
    selecting = replace(pipeline, warmup_slots=0)  # the policy as well
    for _ in range(SLOTS):
        state, _record = step(selecting, state, views, everybody)
    if delayed is not None:
        delayed.warm_up()


def without_extras(pipeline: Pipeline) -> Pipeline:
    """Return the loop that only says who is where, by the views of all cameras."""
    return replace(
        pipeline,
        predictor=ConstantVelocity(),
        steering=None,
        warmup_slots=sys.maxsize,
        needs=frozenset(),
        feedback=None,
        rests=None,
    )


class Beside:
    """Processes that compile what a loop needs; all edges of a program share them.

    The first compiles the filter, and the second, for its memory, everything else.
    """

    _running: Beside | None = None

    def __init__(self, *given: object) -> None:
        """Start; `given` is what `warm_up` takes.

        Raises:
            pickle.PicklingError, AttributeError, TypeError: for parts of a plug-in.
        """
        self._process = start_call(_compile_filter, *given)
        self._users, self._left_s, self._said_s = 0, 0.0, time.monotonic()
        self._thread = threading.Thread(target=self._go_on, args=given, daemon=True)
        self._thread.start()

    @classmethod
    def start(
        cls, pipeline: Pipeline, joints: Sequence[str], delayed: Delayed | None
    ) -> Beside | None:
        """Start them; None where all is compiled, or compiled code cannot be kept."""
        if not isinstance(pipeline.estimator, Filtered) or is_cached(step_slot) is not False:
            return None
        if cls._running is None or cls._running.ended():
            plain = replace(pipeline, clock=time.monotonic, waking=None)
            try:
                cls._running = cls(plain, joints, delayed)
            except (pickle.PicklingError, AttributeError, TypeError):
                return None
        cls._running._users += 1
        return cls._running

    def ended(self) -> bool:
        """Return whether everything is compiled, or cannot be."""
        return not self._thread.is_alive()

    def left_s(self) -> float:
        """Return the seconds that are left; 0 while that is unknown."""
        return max(self._left_s - (time.monotonic() - self._said_s), min(self._left_s, 1.0))

    def leave(self) -> None:
        """End it unless another edge waits for it."""
        self._users -= 1
        if not self._users:
            self._process.terminate()
            self._thread.join()

    def _go_on(self, *given: object) -> None:
        begun_s = time.monotonic()
        with self._process as first:
            self._follow(first.stderr or ())
        if first.returncode == 0:
            self._process = start_call(_compile_rest, time.monotonic() - begun_s, *given)
            if self._users < 1:  # left meanwhile
                self._process.terminate()
            with self._process as second:
                self._follow(second.stderr or ())

    def _follow(self, said: Iterable[bytes]) -> None:
        """Read what a process says is left."""
        for line in said:
            if found := re.search(rb"(\d+) s left", line):
                self._left_s, self._said_s = float(found[1]), time.monotonic()


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


def _compile_filter(pipeline: Pipeline, *_: object) -> None:
    _say_progress()
    pipeline.estimator.estimate(pipeline.estimator.begin(), {}, 0.0, pipeline.clock)


def _compile_rest(spent_s: float, pipeline: Pipeline, *given: Any) -> None:
    _say_progress()
    COMPILING.skip("e3pose.estimate", spent_s)
    warm_up(pipeline, *given)


def _say_progress() -> None:
    logging.basicConfig(stream=sys.stderr, format="%(message)s", level=logging.INFO)
