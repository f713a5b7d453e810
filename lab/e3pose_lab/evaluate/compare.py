"""Compare policies over several seeds, in parallel processes: mean and spread."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose.energy.profiles import DeviceProfile, Mode
from e3pose.energy.queues import DEFAULT_BATTERY_WH
from e3pose.evaluate.detect_again import open_pixels
from e3pose.evaluate.figures import Summary, as_json
from e3pose.evaluate.held_out import judge
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import summarise
from e3pose.recording import Recording
from e3pose.select.policies import COUNT
from e3pose.settings.parts import row_of

if TYPE_CHECKING:
    from pathlib import Path

    from e3pose.pipeline import SlotRecord

Replay = Callable[..., Iterator["SlotRecord"]]

# Not averaged over seeds: what is asked for, rather than what came out.
ASKED = ("format", "version", "settings", "recording")


def tasks(
    base: ReplaySettings,
    policies: Sequence[str],
    seeds: int,
    leads: Sequence[int] = (),
) -> list[ReplaySettings]:
    """List the settings of every replay: per policy and lead, seed i with phase i.

    Without `leads` all have the lead of `base`.
    """
    return [
        replace(
            base,
            policy=policy,
            lead_slots=lead,
            seed=base.seed + i,
            phase=base.phase + i,
        )
        for policy in policies
        for lead in leads or (base.lead_slots,)
        for i in range(seeds)
    ]


def compare(
    recording: Recording,
    settings: Sequence[ReplaySettings],
    profile: DeviceProfile | Sequence[DeviceProfile],
    *,
    idle_mode: Mode = "power-saving",
    battery_wh: float | Sequence[float] = DEFAULT_BATTERY_WH,
    jobs: int = -1,
    run: Replay = replay,
    judges: Recording | None = None,
) -> Iterator[Summary]:
    """Replay under each of `settings` and yield their summaries in order, as they become ready.

    Args:
        recording: what to replay; fresh state every time.
        settings: such as `tasks` lists.
        profile: what the cameras draw, one for all or one for each.
        idle_mode: what a camera does that is not selected.
        battery_wh: capacity of the cameras' batteries, one for all or one for each.
        jobs: parallel processes; all processor cores if -1.
        run: replays a recording under settings.
        judges: held-out cameras, which take no part (`evaluate.held_out`).

    Yields:
        One summary per entry of `settings`.
    """
    from joblib import Parallel, delayed, parallel_config

    # Replays are many and small: one thread each, or the processes fight for the cores.
    with parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
        with _interrupts_ignored():
            summaries = Parallel(return_as="generator", batch_size=1)(
                delayed(_one)(recording, each, profile, idle_mode, battery_wh, run, judges)
                for each in settings
            )
        yield from summaries


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Start processes that leave Ctrl-C, which the terminal sends to all of them, to this one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def rows(summaries: Sequence[Summary]) -> list[dict[str, Any]]:
    """Gather summaries into one row per policy, camera count or target error, V, E and lead.

    Returns:
        Rows of `policy`, `cameras` and `target_mm`, at most one of which is a number,
        `quality_weight` and `budget`, null where nobody said, `lead`, `seeds` and every figure of
        the summaries as `{"mean": , "sd": }`: the sample standard deviation over seeds, 0 for one
        seed. A figure that only some seeds have also tells the `count` of those.
    """
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for summary in summaries:
        asked, target = summary.settings, summary.settings.target_error_m
        asks_count = COUNT in row_of(asked).uses
        chosen = target is None and asked.watts is None
        count = asked.num_selected if chosen and asks_count else None
        target_mm = None if target is None else 1000 * target
        weight, budget = asked.quality_weight, asked.budget
        key = (summary.policy, count, target_mm, weight, budget, asked.lead_slots)
        groups.setdefault(key, []).append(as_json(summary))
    return [
        {
            "policy": policy,
            "cameras": count,
            "target_mm": target_mm,
            "quality_weight": weight,
            "budget": budget if isinstance(budget, int | float) else None,
            "lead": lead,
            "seeds": len(group),
            **_averaged(
                [{k: v for k, v in s.items() if k not in (*ASKED, "policy")} for s in group]
            ),
        }
        for (policy, count, target_mm, weight, budget, lead), group in groups.items()
    ]


def _one(
    recording: Recording,
    settings: ReplaySettings,
    profile: DeviceProfile | Sequence[DeviceProfile],
    idle_mode: Mode,
    battery_wh: float | Sequence[float],
    run: Replay,
    judges: Recording | None,
) -> Summary:
    records = list(run(recording, settings))
    if settings.feedback:  # its looks take less than those that were measured
        recording = replace(recording, processor={})
    summary = summarise(
        recording, settings, records, profile, idle_mode=idle_mode, battery_wh=battery_wh
    )
    return summary if judges is None else replace(summary, held_out=judge(judges, records))


def _averaged(figures: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Average the numbers of dictionaries of one shape; keep what is no number, if all agree."""
    keys = list(dict.fromkeys(key for each in figures for key in each))
    averaged: dict[str, Any] = {}
    for key in keys:
        values = [each[key] for each in figures if key in each]
        if isinstance(values[0], Mapping):
            averaged[key] = _averaged(values)
        elif isinstance(values[0], int | float) and not isinstance(values[0], bool):
            averaged[key] = _spread(values, len(figures))
        elif all(value == values[0] for value in values):
            averaged[key] = values[0]
    return averaged


def _spread(values: Sequence[float], expected: int) -> dict[str, float]:
    spread: dict[str, float] = {
        "mean": float(np.mean(values)),
        "sd": float(np.std(values, ddof=1)) if len(values) > 1 else 0.0,
    }
    if len(values) < expected:
        spread["count"] = len(values)
    return spread


def replay_stored(
    recording: Recording, settings: ReplaySettings, folder: Path, detector: str | None = None
) -> Iterator[SlotRecord]:
    """Replay a stored recording; with feedback, detect again in its videos on one thread.

    Args:
        recording: what is stored.
        settings: how to run it.
        folder: where it is stored.
        detector: detects again, with feedback or without; by default that of the recording with
            feedback, and none without.
    """
    anew = settings.feedback or detector is not None
    feedback = settings.feedback
    read_view = (
        open_pixels(recording, folder, detector, threads=1, feedback=feedback) if anew else None
    )
    return replay(recording, settings, read_view=read_view)
