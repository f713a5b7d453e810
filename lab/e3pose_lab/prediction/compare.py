"""Compare predictors on the same windows with the same noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.predict import make_predictor
from e3pose.recording import Recording
from e3pose_lab.prediction.motion import Motion, estimated_motion, true_motion
from e3pose_lab.prediction.scores import (
    PredictionSettings,
    conditions,
    count_windows,
    latencies_ms,
    score,
    window_ends,
)
from e3pose_lab.prediction.tally import Tally, calibration, figures

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord

Progress = Callable[[Iterable["SlotRecord"]], Iterable["SlotRecord"]]
Tallies = dict[str, dict[str, Tally]]  # condition -> predictor

TIMED_PEOPLE = 4


def motion_of(recording: Recording, progress: Progress = iter) -> Motion:
    """Return the motion of a recording: its truth, else the tracks of all its cameras.

    Args:
        recording: with or without truth.
        progress: wraps the slots that are replayed where there is no truth.
    """
    if recording.truth is not None and recording.truth.annotated.any():
        return true_motion(recording, recording.truth)
    from e3pose.evaluate.replay import ReplaySettings, replay

    settings = ReplaySettings(pipeline="paper", policy="all", num_selected=len(recording.rig))
    return estimated_motion(recording, progress(replay(recording, settings)))


def only_slots(recording: Recording, parts: Sequence[tuple[int, int]]) -> Recording:
    """Return a recording whose truth is known in some parts alone, such as those held out.

    Args:
        recording: with truth.
        parts: the first slot of each, and the one before which it ends.

    Raises:
        InputError: when it has no truth, or no such slots.
    """
    if recording.truth is None:
        raise InputError(f"{recording.name}: slots: found no truth, expected it to take a part of")
    joints_m = np.full_like(recording.truth.joints_m, np.nan)
    for first, end in parts:
        if not 0 <= first < end <= recording.num_slots:
            raise InputError(
                f"{recording.name}: slots: found {first}:{end}, expected a part of "
                f"0:{recording.num_slots}"
            )
        joints_m[first:end] = recording.truth.joints_m[first:end]
    return replace(recording, truth=replace(recording.truth, joints_m=joints_m))


def evaluate_motion(
    motion: Motion,
    predictors: Sequence[str],
    settings: PredictionSettings,
    advance: Callable[[int], None] = lambda windows: None,
) -> Tallies:
    """Measure predictors by name on one motion.

    Args:
        motion: what really happened.
        predictors: names of `PREDICTORS`.
        settings: how to measure.
        advance: called with how many windows were predicted since the last call.

    Returns:
        Condition -> predictor -> tally.

    Raises:
        InputError: when a predictor is unknown, or the motion is too short.
    """
    makers = {name: make_predictor(name, motion.skeleton) for name in predictors}
    if count_windows(motion, settings) == 0:
        raise InputError(
            f"{motion.name}: found nobody in {settings.history_slots} consecutive slots "
            f"({motion.source}), expected at least one such history"
        )
    tallies: Tallies = {}
    for condition, seen in conditions(motion, settings).items():
        tallies[condition] = {}
        for name, predictor in makers.items():
            total = Tally.zero(len(settings.leads))
            for windows, part in score(predictor, motion, seen, settings):
                total += part
                advance(windows)
            tallies[condition][name] = total
    return tallies


def pooled(each: Sequence[Tallies], num_leads: int) -> Tallies:
    """Add up the tallies of several motions: every joint counts the same."""
    total: Tallies = {}
    for tallies in each:
        for condition, predictors in tallies.items():
            for name, part in predictors.items():
                group = total.setdefault(condition, {})
                group[name] = group.get(name, Tally.zero(num_leads)) + part
    return total


def as_figures(tallies: Tallies, settings: PredictionSettings) -> dict[str, Any]:
    """Return condition -> predictor -> figure -> lead -> number."""
    return {
        condition: {name: figures(part, settings.leads) for name, part in predictors.items()}
        for condition, predictors in tallies.items()
    }


def as_calibration(tallies: Tallies) -> dict[str, Any]:
    """Return condition -> predictor -> groups of joints, of predictors that state their errors."""
    return {
        condition: {name: groups for name, part in by_name.items() if (groups := calibration(part))}
        for condition, by_name in tallies.items()
    }


def describe_motion(motion: Motion, settings: PredictionSettings) -> dict[str, Any]:
    """Describe the motion predicted: name, truth or estimates, frame rate, people and windows."""
    return {
        "recording": motion.name,
        "motion": motion.source,
        "fps": 1.0 / motion.interval_s,
        "people": len(motion.people),
        "windows": count_windows(motion, settings),
    }


def time_predictors(
    motion: Motion,
    predictors: Sequence[str],
    settings: PredictionSettings,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Any]:
    """Time calls for four people: predictor -> `people` and lead -> median and p99 in ms."""
    before = np.arange(1 - settings.history_slots, 1)
    histories = [
        joints_m[ends[:TIMED_PEOPLE, None] + before]
        for joints_m in motion.people
        if len(ends := window_ends(joints_m, settings))
    ]
    people = np.concatenate(histories)
    history = np.swapaxes(people[np.arange(TIMED_PEOPLE) % len(people)], 0, 1)
    return {
        name: {
            "people": TIMED_PEOPLE,
            "leads": latencies_ms(
                make_predictor(name, motion.skeleton),
                history,
                motion.interval_s,
                settings.leads,
                clock,
            ),
        }
        for name in predictors
    }
