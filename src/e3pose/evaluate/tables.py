"""Figures as tables for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from e3pose.evaluate.energy_figures import PAPER_SAVINGS
from e3pose.evaluate.figures import Summary, as_json
from e3pose.plural import counted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# Heading, path inside a row, digits. Columns that no row has are left out.
COLUMNS: tuple[tuple[str, tuple[str, ...], int], ...] = (
    ("cameras on", ("selection", "mean_cameras"), 2),
    ("PCP 1 %", ("metrics", "pcp", "actor1"), 1),
    ("PCP 2 %", ("metrics", "pcp", "actor2"), 1),
    ("PCP 3 %", ("metrics", "pcp", "actor3"), 1),
    ("PCP avg %", ("metrics", "pcp", "average"), 2),
    ("AP25 %", ("metrics", "ap", "25"), 1),
    ("AP50 %", ("metrics", "ap", "50"), 1),
    ("AP100 %", ("metrics", "ap", "100"), 1),
    ("AP150 %", ("metrics", "ap", "150"), 1),
    ("MPJPE mm", ("metrics", "mpjpe_mm"), 1),
    ("p95 mm", ("metrics", "p95_mm"), 0),
    ("p99 mm", ("metrics", "p99_mm"), 0),
    ("jitter m/s2", ("metrics", "acceleration_error_mps2"), 2),
    ("recall", ("metrics", "recall_500mm"), 3),
    ("ids", ("identities",), 1),
    ("id changes", ("metrics", "id_switches"), 1),
    ("expected mm", ("expected", "error_mm"), 1),
    ("coverage 90", ("expected", "coverage_90"), 1),
    ("saving %", ("energy", "saving_percent"), 1),
    ("ms a slot", ("stage_ms", "slot", "median"), 2),
)
TELLING = 1.5  # how far keypoints may be off what the noise file states, unsaid
TELLING_PX = 3.0  # of shifts that are worth a line
OF_ONE_REPLAY = {"p95 mm", "jitter m/s2"}  # a comparison has little room
PREDICT = ("predict ms", ("stage_ms", "predict", "median"), 3)  # beside leads, which it grows with
FIGURE_NAMES = {
    "cameras on": "cameras on, mean a slot",
    "PCP 1 %": "PCP actor 1, %",
    "PCP 2 %": "PCP actor 2, %",
    "PCP 3 %": "PCP actor 3, %",
    "PCP avg %": "PCP average of actors 1-3, %",
    "p95 mm": "error that 95 % of the joints stay below, mm",
    "p99 mm": "error that 99 % of the joints stay below, mm",
    "jitter m/s2": "error of the joints' acceleration, m/s2",
    "recall": "recall within 500 mm",
    "ids": "identities given, of anybody",
    "id changes": "changes of identity of labelled people",
    "expected mm": "error that the estimator expects, mm",
    "coverage 90": "joints within its 90 % band, %",
    "saving %": "energy saved (CPU, GPU, WiFi, DDR), %",
    "ms a slot": "edge time, median ms a slot",
}


def print_comparison(rows: Sequence[Mapping[str, Any]], console: Console | None = None) -> None:
    """Print the rows of a comparison: means, with the spread over seeds where there are several."""
    from rich.table import Table

    table = Table(title="mean +- standard deviation over seeds", title_justify="left")
    table.add_column("policy", no_wrap=True)
    table.add_column("C", justify="right")
    leads = len({row["lead"] for row in rows}) > 1
    if leads:
        table.add_column("lead", justify="right")
    table.add_column("seeds", justify="right")
    known = (*COLUMNS, PREDICT) if leads else COLUMNS
    columns = [
        column
        for column in known
        if column[0] not in OF_ONE_REPLAY and any(_find(row, column[1]) for row in rows)
    ]
    for heading, _, _ in columns:
        table.add_column(heading, justify="right")
    for row in rows:
        cells = [_cell(_find(row, path), digits) for _, path, digits in columns]
        lead = [str(row["lead"])] if leads else []
        table.add_row(row["policy"], _asked(row), *lead, str(row["seeds"]), *cells)
    _print(table, console)
    _print(_devices(rows), console)


def _devices(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return what every row saves on the paper's devices, and against the paper's 3 of 5."""
    from rich.table import Table

    table = Table(
        title="power of CPU, GPU, WiFi and memory saved, %, and times the paper's saving with 3 of "
        "5 cameras;\nidle cameras in power-saving mode, and (aggressive) not even capturing",
        title_justify="left",
    )
    table.add_column("policy", no_wrap=True)
    table.add_column("C", justify="right")
    for name in PAPER_SAVINGS:
        for heading in (name, "x paper", "aggressive", "x paper"):
            table.add_column(heading, justify="right")
    for row in rows:
        cells = [
            _cell(_find(row, ("energy", "devices", name, key)), digits)
            for name in PAPER_SAVINGS
            for key, digits in (
                ("saving_percent", 1),
                ("times_paper", 2),
                ("aggressive_saving_percent", 1),
                ("aggressive_times_paper", 2),
            )
        ]
        table.add_row(row["policy"], _asked(row), *cells)
    return table


def _asked(row: Mapping[str, Any]) -> str:
    """Return what was asked for: cameras a slot, or at most so many millimetres."""
    target_mm = row.get("target_mm")
    if target_mm is not None:
        return f"{target_mm:g} mm"
    return "-" if row["cameras"] is None else f"{row['cameras']:.3g}"


def print_summary(summary: Summary, console: Console | None = None) -> None:
    """Print the figures of one replay and what every camera did."""
    from rich.table import Table

    title = f"{summary.policy} over {counted(summary.slots, 'slot')}"
    if summary.smooth is not None:
        title += f", smoothed ({summary.smooth})"
    figures = Table(title=title, title_justify="left", show_header=False)
    figures.add_column()
    figures.add_column(justify="right")
    table = as_json(summary)
    for heading, path, digits in COLUMNS:
        value = _find(table, path)
        if value is not None:
            figures.add_row(FIGURE_NAMES.get(heading, heading), f"{value:.{digits}f}")
    _print(figures, console)
    for line in noise_lines(summary):
        _print(line, console)
    selection, energy = summary.selection, summary.energy
    if selection is None or energy is None:
        return
    cameras = Table(
        title=f"cameras as {energy.profile}, batteries of {energy.battery_wh:g} Wh",
        title_justify="left",
    )
    cameras.add_column("camera", no_wrap=True)
    for heading in ("slots on %", "saving %", "mean W", "battery h"):
        cameras.add_column(heading, justify="right")
    for camera_id, share in selection.duty.items():
        figure = energy.cameras[camera_id]
        cameras.add_row(
            camera_id,
            f"{100 * share:.1f}",
            f"{figure.saving_percent:.1f}",
            f"{figure.mean_watts:.2f}",
            f"{figure.battery_hours:.2f}",
        )
    _print(cameras, console)


def noise_lines(summary: Summary) -> list[str]:
    """Return a line for each camera whose keypoints are clearly other than files say."""
    noise = summary.noise
    if noise is None:
        return []
    lines = [
        f"{camera_id}: keypoint noise {factor:.1f}x what {noise.file} states"
        for camera_id, factor in noise.factors.items()
        if not 1 / TELLING <= factor <= TELLING
    ]
    return lines + [
        f"{camera_id}: keypoints are {length:.0f} px off, all the same way: "
        f"{right:+.0f} right, {down:+.0f} down; taken off, but check its calibration"
        for camera_id, (right, down) in noise.shifts_px.items()
        if (length := math.hypot(right, down)) >= TELLING_PX
    ]


def _print(table: Table | str, console: Console | None) -> None:
    from rich.console import Console

    if console is None:
        console = Console()
        if not console.is_terminal:  # a file or a pipe has no width to fit
            console = Console(width=240)
    console.print(table)


def _find(figures: Mapping[str, Any], path: Sequence[str]) -> Any:
    value: Any = figures
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _cell(spread: Mapping[str, float] | None, digits: int) -> str:
    if spread is None:
        return "-"
    mean = f"{spread['mean']:.{digits}f}"
    deviation = f"{spread['sd']:.{digits}f}"
    return f"{mean} +- {deviation}" if float(deviation) > 0 else mean
