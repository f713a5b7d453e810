"""`e3pose evaluate-predictor`: the error of motion predictors on recordings."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from e3pose.base.errors import InputError
from e3pose.cli.options import OUTPUT, Flag, Whole, check_outputs
from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote

if TYPE_CHECKING:
    from e3pose_lab.prediction.scores import PredictionSettings
    from e3pose_lab.prediction.windows import Window

OURS = ("error-by-lead.svg",)  # marks a folder of pictures as one that may be replaced


@Parameter(name="*", group=Group("Histories", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class HistoryOptions:
    """Motion to predict, and the history to predict it from."""

    leads: str = "1,2,3,5,8,10,15"
    """Comma-separated numbers of slots ahead."""
    history: Whole = 10
    """History length M in slots."""
    noise_mm: float = 20.0
    """Standard deviation of the noise per coordinate of noisy histories."""
    missing: float = 0.2
    """Share of joints missing from noisy histories."""
    seed: Whole = 0
    """Random seed."""
    every: Whole = 1
    """Predict in every N-th slot only."""
    slots: str | None = None
    """Evaluate only these slots, FIRST:END, comma-separated; for example the slots held out of
    training."""

    def settings(self) -> PredictionSettings:
        """Return the settings that these options mean."""
        from e3pose_lab.prediction.scores import PredictionSettings

        return PredictionSettings(
            leads=_leads(self.leads),
            history_slots=self.history,
            noise_m=self.noise_mm / 1000,
            missing=self.missing,
            seed=self.seed,
            every=self.every,
        )


HISTORY = HistoryOptions()


def evaluate_predictor(
    recordings: Annotated[list[Path], Parameter(name="RECORDING", negative="")],
    /,
    *,
    predictors: str | None = None,
    history: HistoryOptions = HISTORY,
    each: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
    plot: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    pictures: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> None:
    """Evaluate motion predictors: error by lead, box overlap, calibration, latency.

    Example: `e3pose evaluate-predictor cmu/02_10 cmu/02_08 --leads 1,5,10`

    The reference motion is the truth of a recording or, without truth, the tracks estimated with
    all cameras. With truth, each history is tested exact and again with noise and missing joints.

    Parameters
    ----------
    recordings
        Recording folders.
    predictors
        Comma-separated names. Default: all.
    each
        Also print the tables of each recording.
    json_file
        Write the figures here as JSON; - is standard output.
    plot
        Write a page with curves of error and box overlap here (.html).
    pictures
        Write pictures (.svg) to this folder: `skeletons` (predicted and actual, at the 50th, 75th
        and 95th percentile of error), `error-by-lead`, `expected-errors`.
    overwrite
        Replace the folder of pictures.
    """
    from e3pose.base.atomic import check_free
    from e3pose.evaluate.columns import table_console
    from e3pose_lab.prediction.plot import check_plot, write_plot
    from e3pose_lab.prediction.tables import print_calibration, print_figures, print_latency

    if plot is not None:
        check_plot(plot)
    if pictures is not None:
        check_free(pictures, overwrite, OURS)
    for recording in recordings:
        check_outputs(recording, {"--json": json_file, "--plot": plot})
    settings, names = history.settings(), _names(predictors)
    wanted = _slots(history.slots)
    report, windows = _measure(recordings, names, settings, wanted, pictures is not None)
    if plot is not None:
        write_plot(plot, report["pooled"], report["calibration"])
    if pictures is not None:
        _draw(pictures, overwrite, report, windows, names, settings)
    if is_stdout(json_file):
        write_json(json_file, report)
        return
    console = table_console()
    shown = report["recordings"]
    for one in shown if each or len(shown) == 1 else ():
        print_figures(one["recording"], one["figures"], settings.leads, console)
    if len(shown) > 1:
        title = f"all {len(shown)} recordings"
        print_figures(title, report["pooled"], settings.leads, console)
    print_calibration(report["calibration"], console)
    print_latency(report["latency_ms"], settings.leads, console)
    write_json(json_file, report)
    wrote(plot)
    wrote(pictures)


def _measure(
    paths: list[Path],
    names: list[str],
    settings: Any,
    slots: list[tuple[int, int]],
    keep_windows: bool,
) -> tuple[dict[str, Any], list[Window]]:
    """Measure recording by recording, so that only one is in memory; keep some windows to draw."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    from e3pose.cli.placed import load_placed
    from e3pose.predict import make_predictor
    from e3pose_lab.prediction.compare import (
        as_calibration,
        as_figures,
        describe_motion,
        evaluate_motion,
        motion_of,
        only_slots,
        pooled,
        time_predictors,
    )
    from e3pose_lab.prediction.windows import sample_windows

    for name in names:
        make_predictor(name)  # a wrong name fails before minutes of work, not after
    parts, rows, latency = [], [], None
    windows: list[Window] = []
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        whole = bar.add_task("recordings", total=len(paths))
        for path in paths:
            source = load_placed(path)
            if slots:
                source = only_slots(source, slots)
            motion = motion_of(
                source, partial(bar.track, total=source.num_slots, description="estimating")
            )
            about = describe_motion(motion, settings)
            runs = len(names) * (1 if motion.source == "estimates" else 2)
            task = bar.add_task(escape(path.name), total=runs * about["windows"])
            parts.append(evaluate_motion(motion, names, settings, partial(bar.advance, task)))
            rows.append({**about, "figures": as_figures(parts[-1], settings)})
            if keep_windows:
                ranking = make_predictor(_pictured(names)[0], motion.skeleton)
                windows += sample_windows(motion, settings, ranking)
            latency = latency or time_predictors(motion, names, settings)
            bar.remove_task(task)
            bar.advance(whole)
    total = pooled(parts, len(settings.leads))
    report = {
        "settings": asdict(settings),
        "pooled": as_figures(total, settings),
        "calibration": as_calibration(total),
        "recordings": rows,
        "latency_ms": latency,
    }
    return report, windows


def _draw(
    folder: Path,
    overwrite: bool,
    report: dict[str, Any],
    windows: list[Window],
    names: list[str],
    settings: Any,
) -> None:
    from e3pose.base.atomic import atomic_folder
    from e3pose.predict import make_predictor
    from e3pose_lab.prediction.pictures import (
        CLAIMS,
        CURVES,
        SKELETONS,
        draw_claims,
        draw_curves,
    )
    from e3pose_lab.prediction.skeleton_picture import draw_skeletons
    from e3pose_lab.prediction.windows import choose_windows

    with atomic_folder(folder, overwrite, OURS) as temporary:
        draw_curves(temporary / CURVES, report["pooled"])
        draw_claims(temporary / CLAIMS, report["calibration"])
        chosen = choose_windows(windows)
        if chosen:
            shown = _pictured(names)
            draw_skeletons(temporary / SKELETONS, chosen, shown, settings.leads, make_predictor)


def _pictured(names: list[str]) -> list[str]:
    """Return the predictors whose skeletons are drawn: the best first, the paper's baseline."""
    best = "attention-lstm" if "attention-lstm" in names else names[-1]
    return list(dict.fromkeys([best, *(n for n in names if n == "constant-velocity")]))


def _names(text: str | None) -> list[str]:
    if text is None:
        from e3pose.predict import PREDICTORS

        return list(PREDICTORS)
    return list(dict.fromkeys(name.strip() for name in text.split(",")))


def _slots(text: str | None) -> list[tuple[int, int]]:
    parts = []
    for part in [] if text is None else text.split(","):
        first, _, end = part.partition(":")
        if not (first.isdecimal() and end.isdecimal() and len(part) < 40):
            raise InputError(f"--slots: found {part[:40]!r}, expected FIRST:END, such as 3800:5000")
        parts.append((int(first), int(end)))
    return parts


def _leads(text: str) -> tuple[int, ...]:
    try:
        return tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        raise InputError(
            f"--leads: found {text[:40]!r}, expected comma-separated whole numbers, such as 1,5,10"
        ) from None
