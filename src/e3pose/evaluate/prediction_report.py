"""Figures of predictors as tables for a terminal, and as a page with curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from e3pose.atomic import atomic_file
from e3pose.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

# Figure, heading, digits.
TABLES = (
    ("mpjpe_mm", "absolute MPJPE, mm", 1),
    ("root_relative_mpjpe_mm", "MPJPE relative to the hips, mm", 1),
    ("box_iou", "IoU of predicted and actual boxes", 3),
    ("expected_mm", "expected error as the predictor states it, mm", 1),
    ("within_expected", "share of joints within the stated error", 2),
)
COLOURS = ("#1f2937", "#b45309", "#1e40af", "#15803d", "#7c3aed", "#be123c", "#0e7490")
DASHES = {"exact": "solid", "noisy": "dash", "estimated": "dot"}
PANELS = (("mpjpe_mm", "absolute MPJPE, mm"), ("box_iou", "IoU of predicted and actual boxes"))


def print_figures(
    title: str, figures: Mapping[str, Any], leads: Sequence[int], console: Console
) -> None:
    """Print one table per condition and figure: a row per predictor, a column per lead.

    Args:
        title: whose figures these are.
        figures: condition -> predictor -> figure -> lead -> number.
        leads: slots ahead.
        console: where to.
    """
    for condition, predictors in figures.items():
        for key, heading, digits in TABLES:
            rows = {name: row[key] for name, row in predictors.items() if key in row}
            if not rows:
                continue
            _print(f"{title}, {condition} histories: {heading}", rows, leads, digits, console)


def print_latency(latency: Mapping[str, Any], leads: Sequence[int], console: Console) -> None:
    """Print the median time of a call."""
    people = next(iter(latency.values()))["people"] if latency else 0
    rows = {
        name: {lead: times["median"] for lead, times in each["leads"].items()}
        for name, each in latency.items()
    }
    _print(f"time of a call for {people} people, median ms", rows, leads, 3, console)


def check_plot(path: Path) -> None:
    """Raise `InputError` unless a page can be written at `path`."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--plot: found {path.name!r}, expected a name that ends in .html")


def write_plot(path: Path, figures: Mapping[str, Any]) -> None:
    """Write a page with error and IoU against lead that needs no network to be looked at.

    Args:
        path: the page.
        figures: condition -> predictor -> figure -> lead -> number.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    check_plot(path)
    figure = make_subplots(1, 2, subplot_titles=[heading for _, heading in PANELS])
    names = list(dict.fromkeys(name for group in figures.values() for name in group))
    for condition, predictors in figures.items():
        for name, row in predictors.items():
            for column, (key, _) in enumerate(PANELS, start=1):
                curve = row.get(key, {})
                figure.add_trace(
                    go.Scatter(
                        x=[int(lead) for lead in curve],
                        y=list(curve.values()),
                        name=f"{name}, {condition}",
                        legendgroup=f"{name}, {condition}",
                        showlegend=column == 1,
                        mode="lines+markers",
                        line={
                            "color": COLOURS[names.index(name) % len(COLOURS)],
                            "dash": DASHES.get(condition, "solid"),
                        },
                    ),
                    row=1,
                    col=column,
                )
    figure.update_xaxes(title_text="slots ahead", rangemode="tozero")
    figure.update_yaxes(rangemode="tozero", row=1, col=1)
    figure.update_layout(template="plotly_white", height=520, title="Prediction against lead")
    with atomic_file(path) as temporary:
        figure.write_html(temporary, include_plotlyjs=True, auto_open=False)


def _print(
    title: str,
    rows: Mapping[str, Mapping[str, float]],
    leads: Sequence[int],
    digits: int,
    console: Console,
) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table()
    table.add_column("slots ahead", no_wrap=True)
    for lead in leads:
        table.add_column(str(lead), justify="right")
    for name, by_lead in rows.items():
        cells = [f"{by_lead[str(n)]:.{digits}f}" if str(n) in by_lead else "-" for n in leads]
        table.add_row(name, *cells)
    console.print(Text(title, style="italic"))  # a title of the table would wrap at its width
    console.print(table)
