"""Figures of predictors as a page with curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError

COLOURS = ("#1f2937", "#b45309", "#1e40af", "#15803d", "#7c3aed", "#be123c", "#0e7490")
DASHES = {"exact": "solid", "noisy": "dash", "estimated": "dot"}
PANELS = (("mpjpe_mm", "absolute MPJPE, mm"), ("box_iou", "IoU of predicted and actual boxes"))
STATED_ERROR = "expected against actual error, mm"


def check_plot(path: Path) -> None:
    """Raise `InputError` unless a page can be written at `path`."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--plot: found {path.name!r}, expected a name that ends in .html")


def write_plot(path: Path, figures: Mapping[str, Any], calibration: Mapping[str, Any]) -> None:
    """Write a self-contained page with error, IoU and stated against actual error.

    Args:
        path: the page.
        figures: condition -> predictor -> figure -> lead -> number.
        calibration: condition -> predictor -> groups of joints; without any, nor is its panel.
    """
    from plotly.subplots import make_subplots

    check_plot(path)
    stated = any(calibration.values())
    titles = [heading for _, heading in PANELS] + [STATED_ERROR] * stated
    page = make_subplots(1, len(titles), subplot_titles=titles)
    names = list(dict.fromkeys(name for group in figures.values() for name in group))
    for condition, predictors in figures.items():
        for name, row in predictors.items():
            colour = COLOURS[names.index(name) % len(COLOURS)]
            for column, (key, _) in enumerate(PANELS, start=1):
                curve = row.get(key, {})
                leads = [int(lead) for lead in curve]
                _draw(page, column, name, condition, colour, leads, list(curve.values()))
            groups = calibration.get(condition, {}).get(name)
            if groups:
                expected = [group["expected_mm"] for group in groups]
                actual = [group["actual_mm"] for group in groups]
                _draw(page, len(titles), name, condition, colour, expected, actual)
    page.update_xaxes(title_text="slots ahead", rangemode="tozero")
    page.update_yaxes(rangemode="tozero", row=1, col=1)
    if stated:
        page.update_xaxes(title_text="expected", type="log", row=1, col=len(titles))
        page.update_yaxes(title_text="actual", type="log", row=1, col=len(titles))
    page.update_layout(template="plotly_white", height=520, title="Predictors compared")
    with atomic_file(path) as temporary:
        page.write_html(temporary, include_plotlyjs=True, auto_open=False)


def _draw(
    page: Any,
    column: int,
    name: str,
    condition: str,
    colour: str,
    x: Sequence[float],
    y: Sequence[float],
) -> None:
    import plotly.graph_objects as go

    label = f"{name}, {condition}"
    line = {"color": colour, "dash": DASHES.get(condition, "solid")}
    page.add_trace(
        go.Scatter(
            x=list(x),
            y=list(y),
            name=label,
            legendgroup=label,
            showlegend=column == 1,
            mode="lines+markers",
            line=line,
        ),
        row=1,
        col=column,
    )
