"""`e3pose evaluate`: several policies over one recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.cli.options import (
    GOAL,
    OUTPUT,
    EnergyOptions,
    HoldOut,
    LoopOptions,
    Redetect,
    Whole,
    as_typed,
    check_outputs,
    options_of,
    warn,
)
from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote
from e3pose.cli.placed import load_placed
from e3pose.cli.progress import track_progress
from e3pose.cli.replaying import FaultOptions
from e3pose.edge.precompile import warm_up
from e3pose.evaluate.detect_again import open_pixels
from e3pose.evaluate.figures import Summary
from e3pose.evaluate.held_out import joined, turns
from e3pose.recording import Recording
from e3pose.select.policies import BUDGET, COUNT, WEIGHT, PolicyRow
from e3pose.settings.energy import AWAKE, EnergyPlan
from e3pose.settings.loop import FEEDBACK, ReplaySettings
from e3pose.settings.parts import make_pipeline, row_of, warnings_of
from e3pose_lab.evaluate.compare import Replay, compare, replay_stored, rows, tasks
from e3pose_lab.evaluate.drawing import check_svg
from e3pose_lab.evaluate.lead_picture import draw_leads
from e3pose_lab.evaluate.table import print_comparison

if TYPE_CHECKING:
    from e3pose.settings.faults import Faults

LOOP, ENERGY, FAULTS = LoopOptions(), EnergyOptions(), FaultOptions()

POLICIES = {"policy": "--policies"}
MAX_SEEDS = 10_000
WITH: dict[str, Any] = {"feedback": True}  # mypy does not see options of settings
MAX_JOBS = 1000


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """Settings to compare: every combination is a row."""

    policies: str | None = None
    """Comma-separated: all, random, round-robin, independent, central-2d, e3pose-mv, e3pose,
    information; each also with feedback, such as all+feedback. Default: all, round-robin, e3pose,
    information; with --pipeline paper the paper's rows; with --target-error or --rest, information
    only."""
    cameras: Annotated[str | None, Parameter(alias="-C", group=GOAL)] = None
    """Cameras per slot C, comma-separated; a mean such as 1.15 is allowed. Default: 2, and 3 with
    --pipeline paper."""
    leads: str | None = None
    """Comma-separated values of --lead. -V and -E also take several values each, of which every
    combination is compared."""
    seeds: Whole = 5
    """Repetitions per policy."""

    def settings(self, loop: LoopOptions, plan: EnergyPlan, faults: Faults) -> list[ReplaySettings]:
        """Return the settings of every run: repetitions of a row follow each other."""
        loops = _balances(loop)
        names = _names(_usual(loops[0].settings()) if self.policies is None else self.policies)
        given = self.cameras
        counts = [None] if given is None else [*_numbers("--cameras", given, "1.15,2")]
        ahead = [] if self.leads is None else _counts("--leads", self.leads)
        return [
            each
            for name in names
            for row in [row_of(_settings(loops[0], name))]
            for count in (counts if COUNT in row.uses else counts[:1])
            for one in _that_matter(loops, row)
            for each in tasks(
                replace(
                    _settings(one, name, count).for_rig(len(plan.profiles), plan), faults=faults
                ),
                [name.removesuffix(FEEDBACK)],
                self.seeds,
                ahead,
            )
        ]


def _settings(loop: LoopOptions, name: str, count: float | None = None) -> ReplaySettings:
    """Return the settings of a policy, whose name ends in `+feedback` where cameras get it."""
    own = replace(loop, **WITH) if name.endswith(FEEDBACK) else loop
    return own.settings(name.removesuffix(FEEDBACK), count)


GRID = GridOptions()


def evaluate(
    recording: Path,
    /,
    *,
    grid: GridOptions = GRID,
    loop: LoopOptions = LOOP,
    energy: EnergyOptions = ENERGY,
    faults: FaultOptions = FAULTS,
    jobs: Whole = -1,
    detector: Redetect = None,
    hold_out: HoldOut = (),
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
    plot: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
) -> None:
    """Compare policies on a recording: accuracy, active cameras, energy saved.

    Example: `e3pose evaluate shelf --policies all,round-robin,information --cameras 1.15,2`

    Every policy starts from the same state and sees only the views it selects. Repetition i uses
    seed + i and phase + i. Figures are means over repetitions, with the standard deviation.

    Fault injection: `--kill-camera each@100` fails one camera at slot 100, a different one in each
    repetition; `--loss 0.3` loses 30 % of the views; `--fps 10` lowers the frame rate.

    Parameters
    ----------
    recording
        Recording folder.
    jobs
        Parallel processes. Default: one per processor core.
    json_file
        Write the figures here as JSON, one row per policy, camera count and lead; - is standard
        output.
    plot
        With --leads: plot accuracy and prediction time against the lead here (.svg).
    """
    _check(grid, jobs, plot)
    check_outputs(recording, {"--json": json_file, "--plot": plot})
    whole = faults.downsampled(load_placed(recording))
    with as_typed(
        {
            **options_of(LoopOptions, EnergyOptions, more=("cameras", "detector", "hold_out")),
            **POLICIES,
            **({} if grid.leads is None else {"lead": "--leads"}),
        }
    ):
        runs = []
        for source, judges in turns(whole, hold_out):
            plan = energy.settings().plan(
                source.rig.camera_ids, source.interval_s, source.battery_wh
            )
            settings = grid.settings(loop, plan, faults.day(source, plan.watts))
            # A wrong option fails before hours of work, not after.
            pipelines = [make_pipeline(source, each) for each in settings[:: grid.seeds]]
            runs.append((source, judges, plan, settings))
        source, _, _, settings = runs[0]
        feedback = any(each.feedback for each in settings)
        if detector is not None or feedback:
            open_pixels(source, recording, detector, threads=1, feedback=feedback)
    for words in warnings_of(source, settings[0]):
        warn(words)
    if jobs != 1 and len(settings) > 1:
        warm_up(pipelines[0], source.skeleton.joints)  # compiled once, not in each process
    run = partial(replay_stored, folder=recording, detector=detector)
    found = chain.from_iterable(_compared(*each, jobs, run) for each in runs)
    summaries = list(track_progress(found, len(settings) * len(runs), "evaluate"))
    figures = rows(
        [
            replace(first, held_out=joined([each.held_out for each in summaries[i::count]]))
            for count in [len(settings)]
            for i, first in enumerate(summaries[:count])
        ]
    )
    if plot is not None:
        draw_leads(plot, figures)
    if not is_stdout(json_file):
        print_comparison(figures)
        wrote(plot)
    write_json(json_file, {"rows": figures})


def _compared(
    source: Recording,
    judges: Recording | None,
    plan: EnergyPlan,
    settings: Sequence[ReplaySettings],
    jobs: int,
    run: Replay,
) -> Iterator[Summary]:
    """Replay a recording, or what is left of one, under all settings."""
    return compare(
        source,
        settings,
        plan.profiles,
        idle_mode=plan.idle_mode,
        battery_wh=plan.battery_wh,
        jobs=min(jobs, len(settings)),
        run=run,
        judges=judges,
    )


def _check(grid: GridOptions, jobs: int, plot: Path | None) -> None:
    check_within("--seeds", grid.seeds, 1, MAX_SEEDS)
    if jobs != -1 and not 1 <= jobs <= MAX_JOBS:
        raise InputError(f"--jobs: found {jobs}, expected 1 to {MAX_JOBS}, or -1 for all cores")
    if plot is not None:
        check_svg("--plot", plot)
        if grid.leads is None:
            raise InputError("--plot: found no --leads, expected --leads for its axis")


def _names(text: str) -> list[str]:
    return list(dict.fromkeys(name.strip() for name in text.split(",")))


def _usual(loop: ReplaySettings) -> str:
    if loop.target_error_m is not None or loop.rest != AWAKE:
        return "information"
    if loop.pipeline == "paper":
        return "all,random,independent,e3pose-mv,e3pose"
    return "all,round-robin,e3pose,information"


def _balances(loop: LoopOptions) -> list[LoopOptions]:
    """Return the options for every combination of the values of -E and -V."""
    budgets, weights = (
        [None] if text is None else [f"{value:g}" for value in _numbers(option, text, such_as)]
        for option, text, such_as in (
            ("--budget", loop.budget, "0.6,0.8"),
            ("--quality-weight", loop.quality_weight, "1,10"),
        )
    )
    return [replace(loop, budget=e, quality_weight=v) for e in budgets for v in weights]


def _that_matter(loops: list[LoopOptions], row: PolicyRow) -> list[LoopOptions]:
    """Return the combinations that a policy can tell apart, without the values it does not use."""
    used = [
        replace(
            one,
            budget=one.budget if BUDGET in row.uses or len(loops) == 1 else None,
            quality_weight=one.quality_weight if WEIGHT in row.uses or len(loops) == 1 else None,
        )
        for one in loops
    ]
    return list({(one.budget, one.quality_weight): one for one in used}.values())


def _numbers(option: str, text: str, such_as: str) -> list[float]:
    """Return the numbers in a comma-separated list; raise `InputError` naming the option."""
    found = []
    for part in text.split(","):
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            wanted = f"comma-separated numbers, such as {such_as}"
            raise InputError(option, repr(part.strip()[:40]), wanted)
        found.append(int(value) if value == int(value) else value)
    return list(dict.fromkeys(found))


def _counts(option: str, text: str) -> list[int]:
    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise InputError(
            f"{option}: found {text[:40]!r}, expected comma-separated whole numbers, such as 2,3"
        ) from None
