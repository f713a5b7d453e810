"""`e3pose evaluate`: several policies over one recording."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.cli.bad_days import BadDayOptions
from e3pose.cli.options import (
    EnergyOptions,
    LoopOptions,
    Whole,
    as_typed,
    check_outputs,
    options_of,
    warn,
)

LOOP, ENERGY, BAD_DAY = LoopOptions(), EnergyOptions(), BadDayOptions()

POLICIES = {"policy": "--policies"}
MAX_SEEDS = 10_000
MAX_JOBS = 1000


def evaluate(
    recording: Path,
    *,
    policies: str | None = None,
    cameras: Annotated[str | None, Parameter(alias="-C")] = None,
    leads: str | None = None,
    seeds: Whole = 5,
    loop: LoopOptions = LOOP,
    energy: EnergyOptions = ENERGY,
    bad_day: BadDayOptions = BAD_DAY,
    jobs: Whole = -1,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
    plot: Path | None = None,
) -> None:
    """Compare policies on a recording: accuracy, cameras on and energy saved, mean and spread.

    Example: `e3pose evaluate shelf --policies all,round-robin,information --cameras 1.15,2`

    Every policy starts afresh and sees only the views it selects. The i-th repetition runs with
    seed + i and phase + i, so that random policies draw anew and others take turns and ties from
    another camera.

    Ask how it copes: `--kill-camera each@100` loses another camera in every repetition, at slot
    100; `--loss 0.3` loses 30 % of the views; `--fps 10` has fewer frames.

    Parameters
    ----------
    recording
        Folder made by `e3pose detect`, `e3pose import` or `e3pose simulate`.
    policies
        Names with commas: all, random, round-robin, independent, central-2d, e3pose-mv, e3pose,
        information. By default all, round-robin, e3pose and information, and with the pipeline
        `paper` the rows of its table; with a target error, information alone.
    cameras
        C, how many cameras detect in a slot; several with commas, means such as 1.15 among them. By
        default 2, and 3 with the paper's pipeline.
    leads
        Several values of --lead, with commas: accuracy and time of prediction against tau.
    seeds
        Repetitions of every policy.
    jobs
        Parallel processes; as many as there are processor cores by default.
    json_file
        Write the figures here, one row per policy, camera count and lead.
    plot
        With --leads: draw accuracy and time of prediction against tau here, an .svg file.
    """
    from e3pose.cli.placed import load_placed
    from e3pose.cli.progress import track_progress
    from e3pose.errors import InputError
    from e3pose.evaluate.compare import compare, rows, tasks
    from e3pose.evaluate.drawing import check_svg
    from e3pose.evaluate.lead_picture import draw_leads
    from e3pose.evaluate.tables import print_comparison
    from e3pose.files.atomic import atomic_file
    from e3pose.select.policies import policy_row
    from e3pose.settings.parts import make_pipeline, noise_warning

    if not 1 <= seeds <= MAX_SEEDS:
        raise InputError(f"--seeds: found {seeds}, expected 1 to {MAX_SEEDS}")
    if jobs != -1 and not 1 <= jobs <= MAX_JOBS:
        raise InputError(f"--jobs: found {jobs}, expected 1 to {MAX_JOBS}, or -1 for all cores")
    if plot is not None:
        check_svg("--plot", plot)
        if leads is None:
            raise InputError("--plot: found no --leads, expected some to draw against")
    check_outputs(recording, {"--json": json_file, "--plot": plot})
    source = bad_day.thinned(load_placed(recording))
    names = _names(_usual(loop) if policies is None else policies)
    counts = [None] if cameras is None else _numbers("--cameras", cameras)
    ahead = [] if leads is None else _counts("--leads", leads)
    with as_typed({**options_of(LoopOptions, EnergyOptions, more=("cameras",)), **POLICIES}):
        plan = energy.settings().plan(source.rig.camera_ids, source.interval_s, source.battery_wh)
        day = bad_day.day(source, plan.watts)
        settings = [
            each
            for name in names
            for count in (counts if policy_row(name).asks_count else counts[:1])
            for each in tasks(
                replace(loop.settings(None, count).for_rig(len(source.rig), plan), bad_day=day),
                [name],
                seeds,
                ahead,
            )
        ]
        for each in settings[::seeds]:  # a wrong option is told before hours of work, not after
            make_pipeline(source, each)
    warn(noise_warning(source, settings[0]))
    summaries = compare(
        source,
        settings,
        plan.profiles,
        idle_mode=plan.idle_mode,
        battery_wh=plan.battery_wh,
        jobs=min(jobs, len(settings)),
    )
    figures = rows(list(track_progress(summaries, len(settings), "evaluate")))
    if json_file is not None:
        with atomic_file(json_file) as temporary:
            temporary.write_text(json.dumps({"rows": figures}, indent=2) + "\n")
    if plot is not None:
        draw_leads(plot, figures)
    print_comparison(figures)


def _names(text: str) -> list[str]:
    return list(dict.fromkeys(name.strip() for name in text.split(",")))


def _usual(loop: LoopOptions) -> str:
    if loop.target_error is not None:
        return "information"
    if loop.pipeline == "paper":
        return "all,random,independent,e3pose-mv,e3pose"
    return "all,round-robin,e3pose,information"


def _numbers(option: str, text: str) -> list[float | None]:
    from e3pose.quantities import number

    wanted = "numbers with commas, as 1.15,2"
    with as_typed({"": option}):
        parts = [number(part.strip(), wanted) for part in text.split(",")]
    return [int(part) if part == int(part) else part for part in dict.fromkeys(parts)]


def _counts(option: str, text: str) -> list[int]:
    from e3pose.errors import InputError

    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise InputError(
            f"{option}: found {text[:40]!r}, expected whole numbers with commas, such as 2,3"
        ) from None
