"""`e3pose evaluate`: several policies over one recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

MAX_SEEDS = 10_000


def evaluate(
    recording: Path,
    *,
    policies: str = "all,random,independent,e3pose-mv,e3pose",
    cameras: Annotated[str | None, Parameter(alias="-C")] = None,
    seeds: int = 5,
    pipeline: str = "paper",
    budget: Annotated[float | None, Parameter(alias="-E")] = None,
    quality_weight: Annotated[float, Parameter(alias="-V")] = 1.0,
    lead: int = 1,
    seed: int = 0,
    phase: int = 0,
    warmup: int = 10,
    predictor: str | None = None,
    reject_outliers: bool = False,
    occlusion_limit: float = 0.1,
    round_trip_ms: float = 50.0,
    profile: str = "xavier-nx",
    idle_mode: Literal["power-saving", "aggressive-power-saving"] = "power-saving",
    battery_wh: float = 50.0,
    jobs: int = -1,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
) -> None:
    """Compare policies on a recording: accuracy, cameras on and energy saved, mean and spread.

    Example: `e3pose evaluate shelf --policies all,random,e3pose --cameras 2,3 --seeds 5`

    Every policy starts afresh and sees only the views it selects. The i-th repetition runs with
    seed + i and phase + i, so that random policies draw anew and others take turns and ties from
    another camera.

    Parameters
    ----------
    recording
        Folder made by `e3pose detect`, `e3pose import` or `e3pose simulate`.
    policies
        Names with commas: all, random, round-robin, independent, central-2d, e3pose-mv, e3pose.
    cameras
        C, how many cameras detect in a slot; several with commas. 3 unless the rig has fewer.
    seeds
        Repetitions of every policy.
    pipeline
        The estimator: `paper` matches and triangulates every slot by itself.
    budget
        E, the share of slots in which a camera may be active, from C/N to 1; C/N + 0.2 by default.
    quality_weight
        V: larger prefers clear views, smaller prefers even batteries.
    lead
        tau, how many slots ahead the cameras are told.
    seed
        The first seed.
    phase
        The first phase: which camera comes first in turns and ties.
    warmup
        M, slots at the start in which every camera detects.
    predictor
        What foresees the poses: constant-velocity. By default the policy's own.
    reject_outliers
        Leave out views that disagree with the others.
    occlusion_limit
        The threshold of the policy `independent`.
    round_trip_ms
        The delay that the policy `central-2d` waits for in every decision.
    profile
        Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file.
    idle_mode
        What a camera does in slots for which it is not selected.
    battery_wh
        Capacity of each camera's battery in watt-hours.
    jobs
        Parallel processes; as many as there are processor cores by default.
    json_file
        Write the figures here, one row per policy and camera count.
    """
    from e3pose.atomic import atomic_file
    from e3pose.cli.progress import track_progress
    from e3pose.energy import load_profile
    from e3pose.errors import InputError
    from e3pose.evaluate.compare import compare, rows, tasks
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline
    from e3pose.evaluate.report import print_comparison
    from e3pose.recording import load_recording

    if not 1 <= seeds <= MAX_SEEDS:
        raise InputError(f"--seeds: found {seeds}, expected 1 to {MAX_SEEDS}")
    if jobs == 0 or jobs < -1:
        raise InputError(f"--jobs: found {jobs}, expected 1 or more, or -1 for all cores")
    if not 0 < battery_wh < float("inf"):
        raise InputError(f"--battery-wh: found {battery_wh:g}, expected more than 0")
    names = _names(policies)
    device = load_profile(profile)
    source = load_recording(recording)
    base = ReplaySettings(
        pipeline=pipeline,
        budget=budget,
        quality_weight=quality_weight,
        lead_slots=lead,
        warmup_slots=warmup,
        predictor=predictor,
        reject_outliers=reject_outliers,
        seed=seed,
        phase=phase,
        occlusion_limit=occlusion_limit,
        round_trip_s=round_trip_ms / 1000,
    )
    counts = [min(3, len(source.rig))] if cameras is None else _counts(cameras)
    settings = tasks(base, names, counts, seeds)
    for each in settings[::seeds]:  # a wrong option is told before hours of work, not after
        make_pipeline(source, each)
    summaries = compare(
        source, settings, device, idle_mode=idle_mode, battery_wh=battery_wh, jobs=jobs
    )
    figures = rows(list(track_progress(summaries, len(settings), "evaluate")))
    if json_file is not None:
        with atomic_file(json_file) as temporary:
            temporary.write_text(json.dumps({"rows": figures}, indent=2) + "\n")
    print_comparison(figures)


def _names(text: str) -> list[str]:
    return list(dict.fromkeys(name.strip() for name in text.split(",")))


def _counts(text: str) -> list[int]:
    from e3pose.errors import InputError

    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise InputError(
            f"--cameras: found {text[:40]!r}, expected whole numbers with commas, such as 2,3"
        ) from None
