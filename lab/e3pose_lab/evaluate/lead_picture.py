"""Picture of policies against lead: accuracy with its spread, and prediction time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose_lab.evaluate.drawing import COLOURS, MARKERS, legend_above, picture

# What tells how good a run was, the first that there is.
ACCURACIES = (
    (("metrics", "pcp", "average"), "PCP average, %"),
    (("metrics", "mpjpe_mm"), "MPJPE, mm"),
)
TIME = ("stage_ms", "predict", "median")
WIDTH_IN, HEIGHT_IN = 7.2, 2.9
APART = 0.06  # slots between policies of one lead, so that bars do not hide each other


def draw_leads(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw the rows of a comparison over several leads.

    Args:
        path: the .svg file.
        rows: of `compare.rows`.

    Raises:
        InputError: when nothing in the rows could be drawn.
    """
    found = [a for a in ACCURACIES if any(_spread(row, a[0]) for row in rows)]
    if not found:
        raise InputError(f"{path}: found a recording without truth, expected one with it")
    key, title = found[0]
    names = list(dict.fromkeys((row["policy"], row["cameras"]) for row in rows))
    several = len({cameras for _, cameras in names}) > 1
    with picture(path, WIDTH_IN, HEIGHT_IN) as figure:
        accuracy, latency = figure.subplots(1, 2)
        for number, (policy, cameras) in enumerate(names):
            mine = [r for r in rows if (r["policy"], r["cameras"]) == (policy, cameras)]
            style = {
                "color": COLOURS[number % len(COLOURS)],
                "marker": MARKERS[number % len(MARKERS)],
                "label": f"{policy}, C = {cameras}" if several and cameras is not None else policy,
            }
            shift = APART * (number - (len(names) - 1) / 2)
            leads, means, deviations = _curve(mine, key)
            shifted = [lead + shift for lead in leads]
            accuracy.errorbar(shifted, means, yerr=deviations, elinewidth=0.8, capsize=2, **style)
            latency.plot(*_curve(mine, TIME)[:2], **style)
        seeds = max(row["seeds"] for row in rows)
        accuracy.set_title(f"{title}, {seeds} seeds" if seeds > 1 else title)
        latency.set_title("prediction, median ms per slot")
        latency.set_ylim(bottom=0)
        for axes in (accuracy, latency):
            axes.set_xlabel("lead, slots")
            axes.set_xticks(sorted({row["lead"] for row in rows}))
        legend_above(figure)


def _spread(row: Mapping[str, Any], path: Sequence[str]) -> Mapping[str, float] | None:
    value: Any = row
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value if isinstance(value, Mapping) and "mean" in value else None


def _curve(
    rows: Sequence[Mapping[str, Any]], path: Sequence[str]
) -> tuple[list[float], list[float], list[float]]:
    """Return leads, means and standard deviations of a figure, where rows have it."""
    known = [(row["lead"], spread) for row in rows if (spread := _spread(row, path))]
    return (
        [lead for lead, _ in known],
        [spread["mean"] for _, spread in known],
        [spread["sd"] for _, spread in known],
    )
