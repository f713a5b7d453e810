"""Online learning on recordings: the loop of `replay` with a trainer beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from e3pose.edge.learn.learner import OnlineTrainer
from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
from e3pose.pipeline import initial_state, step
from e3pose.predict.base import Predictor
from e3pose.recording import Recording


@dataclass(frozen=True, slots=True)
class Rehearsed:
    """Result of a slot of a rehearsal.

    Attributes:
        slot: its index in the recording.
        version: of the network that foresaw.
        seconds: that the slot took, with everything that learning costs it.
        swapped: whether another network was handed over after it.
        predictor: from here on.
    """

    slot: int
    version: int
    seconds: float
    swapped: bool
    predictor: Predictor


def rehearse(
    recording: Recording,
    settings: ReplaySettings,
    trainer: OnlineTrainer,
    predictor: Predictor | None = None,
    wait_until: Callable[[float], None] | None = None,
) -> Iterator[Rehearsed]:
    """Replay a recording, collect its poses, and take every network that is handed over.

    Args:
        recording: what happens.
        settings: of the loop.
        trainer: that learns.
        predictor: to begin with; the policy's own by default.
        wait_until: waits for a time in seconds since the beginning; None runs without pauses, and
            writes the poses in between.

    Yields:
        What became of every slot.
    """
    pipeline = make_pipeline(recording, settings)
    if predictor is not None:
        pipeline = pipeline.with_predictor(predictor)
    state = initial_state(pipeline)
    online = np.ones(len(recording.rig), dtype=bool)
    for slot in range(recording.num_slots):
        if wait_until is not None:
            wait_until(slot * recording.interval_s)
        version = trainer.current
        began = time.perf_counter()
        views = selected_views(recording, slot, state.selections[0] & online)
        state, record = step(pipeline, state, views, online)
        trainer.collect(record)
        new = trainer.poll()
        if new is not None:
            pipeline = pipeline.with_predictor(new)
        seconds = time.perf_counter() - began
        if wait_until is None:
            trainer.write_waiting()
        yield Rehearsed(slot, version, seconds, new is not None, pipeline.predictor)
    trainer.new_run()
