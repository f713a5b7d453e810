"""Replay: run the live loop on a recording, slot by slot, with the selected views only."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Integers
from e3pose.base.errors import InputError
from e3pose.estimate.base import Estimate, Estimator
from e3pose.evaluate.faults import arriving, capacity_j, deaths_s
from e3pose.evaluate.waking import awake_again
from e3pose.model.expected import ExpectedView
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline, SlotRecord, initial_state, step
from e3pose.predict.base import Predictor
from e3pose.recording import Recording
from e3pose.select.policies.base import Policy, Selection
from e3pose.settings.faults import Faults
from e3pose.settings.loop import ReplaySettings as ReplaySettings
from e3pose.settings.parts import make_pipeline as make_pipeline

# What a camera sees in a slot, given the people expected in it; None where it sees nothing.
ReadView = Callable[[int, int, ExpectedView | None], Poses2D | None]
Expected = tuple[ExpectedView, ...] | None


def selected_views(recording: Recording, slot: int, selection: Selection) -> Mapping[int, Poses2D]:
    """Return the views of `slot` from selected cameras only; a lost view is simply not there."""
    return _seen(_recorded(recording), slot, selection, None)


def _seen(
    read_view: ReadView, slot: int, selection: Selection, expected: Expected
) -> Mapping[int, Poses2D]:
    views = {}
    for camera in np.flatnonzero(selection).tolist():
        view = read_view(slot, camera, None if expected is None else expected[camera])
        if view is not None:
            views[camera] = view
    return views


def replay(
    recording: Recording,
    settings: ReplaySettings | None = None,
    clock: Callable[[], float] = time.perf_counter,
    publish: Callable[[Estimate], None] = lambda estimate: None,
    *,
    policy: str | Policy | None = None,
    predictor: str | Predictor | None = None,
    estimator: Estimator[Any] | None = None,
    read_view: ReadView | None = None,
    asks: Callable[[], LookRequest] = lambda: NO_REQUEST,
) -> Iterator[SlotRecord]:
    """Run the recording through `pipeline.step` and yield one record per slot.

    The estimator and the policy are given the views of selected cameras and nothing else: no other
    view and no truth is even read.

    Args:
        recording: what to run.
        settings: how.
        clock: seconds, for stage times only.
        publish: called with the estimate of every slot, before its record is yielded.
        policy: in place of that of the settings: a name, or any object that can `select`.
        predictor: likewise: a name, or any object that can `predict`.
        estimator: in place of that of the pipeline: an `estimate.base.Estimator`.
        read_view: returns what a camera detects in a slot, such as those of
            `evaluate.detect_again.PixelViews`; by default the views of the recording. Required with
            feedback.
        asks: returns the looks that are asked for, once the record of a slot was taken.

    Raises:
        InputError: naming the setting that cannot be had for this recording.
    """
    asked = settings or ReplaySettings()
    settings = replace(
        asked,
        policy=asked.policy if policy is None else policy,
        predictor=asked.predictor if predictor is None else predictor,
        estimator=asked.estimator if estimator is None else estimator,
    )
    if settings.feedback and read_view is None:
        raise InputError("feedback", "without pixels", "a recording with videos")
    pipeline = make_pipeline(recording, settings, clock)
    day = settings.faults
    gone_s = deaths_s(recording, day.kills, settings.phase)
    arriving(len(recording.rig), day.loss, settings.seed, 0)
    views = read_view or _recorded(recording)
    return _run(recording, views, pipeline, day, gone_s, settings.seed, publish, asks)


def _recorded(recording: Recording) -> ReadView:
    return lambda slot, camera, expected: recording.view(slot, camera)


def _run(
    recording: Recording,
    read_view: ReadView,
    pipeline: Pipeline,
    day: Faults,
    gone_s: NDArray[np.float64],
    seed: int,
    publish: Callable[[Estimate], None],
    asks: Callable[[], LookRequest],
) -> Iterator[SlotRecord]:
    state = initial_state(pipeline)
    left_j = capacity_j(recording)
    expected: dict[int, Expected] = {}
    asleep: dict[int, Integers] = {}
    for slot in range(recording.num_slots):
        online = (slot * recording.interval_s < gone_s - 1e-9) & (left_j > 0)
        came = online & arriving(len(online), day.loss, seed, slot)
        if pipeline.rests is not None and slot in asleep:
            costs = pipeline.rests.costs
            came &= awake_again(asleep.pop(slot), costs, recording.interval_s, seed) <= slot
        awake = state.selections[0] & came
        views = _seen(read_view, slot, awake, expected.pop(slot, None))
        try:
            state, record = step(pipeline, state, views, online, publish)
        except InputError as error:
            raise InputError(f"{recording.name}: slot {slot}: {error}") from None
        if record.expected is not None:
            expected[slot + pipeline.lead_slots] = record.expected
        if pipeline.rests is not None:
            asleep[slot + pipeline.lead_slots] = record.asleep_until
        if day.watts is not None:
            left_j = left_j - np.where(record.selected, *day.watts) * recording.interval_s
        yield record
        pipeline = replace(pipeline, request=asks())
