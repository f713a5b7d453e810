"""Figures of predictors as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from e3pose.base.quantities import plural

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
    _print(
        f"time of a call for {plural(people, 'person', 'people')}, median ms",
        rows,
        leads,
        3,
        console,
    )


def print_calibration(calibration: Mapping[str, Any], console: Console) -> None:
    """Print stated beside actual errors of predictors that state any.

    Args:
        calibration: condition -> predictor -> groups of joints.
        console: where to.
    """
    from rich.table import Table
    from rich.text import Text

    for condition, predictors in calibration.items():
        for name, groups in predictors.items():
            table = Table("expected, mm", "actual, mm", "joints, %")
            for column in table.columns:
                column.justify = "right"
            joints = sum(group["joints"] for group in groups)
            for group in groups:
                table.add_row(
                    f"{group['expected_mm']:.1f}",
                    f"{group['actual_mm']:.1f}",
                    f"{100 * group['joints'] / joints:.1f}",
                )
            title = f"{name}, {condition} histories: joints by expected error, all leads"
            console.print(Text(title, style="italic"))
            console.print(table)


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
