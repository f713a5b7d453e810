"""Pictures of predictors: error and overlap against lead, expected against actual error."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from e3pose_lab.evaluate.drawing import INK, MARKERS, colour_of, legend_above, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVES, CLAIMS, SKELETONS = "error-by-lead.svg", "expected-errors.svg", "skeletons.svg"
PANEL_IN, HEIGHT_IN = 3.1, 2.9
LEAST_SHARE = 0.002  # of all joints: a group with fewer says nothing
TICKS_MM = (5, 10, 20, 50, 100, 200, 500)


def draw_curves(path: Path, figures: Mapping[str, Any]) -> None:
    """Draw MPJPE against lead, a panel per kind of histories, and the overlap of boxes.

    Args:
        path: the .svg file.
        figures: condition -> predictor -> figure -> lead -> number.
    """
    first = next(iter(figures))
    panels = [(c, "mpjpe_mm", f"mean error, mm, {c} histories") for c in figures]
    panels.append((first, "box_iou", f"IoU of boxes, {first} histories"))
    with picture(path, PANEL_IN * len(panels), HEIGHT_IN) as figure:
        for axes, (condition, key, title) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            for index, (name, row) in enumerate(figures[condition].items()):
                curve = row.get(key, {})
                axes.plot(
                    [int(lead) for lead in curve],
                    list(curve.values()),
                    marker=MARKERS[index % len(MARKERS)],
                    color=colour_of(name, index),
                    label=name,
                )
            axes.set_title(title)
            axes.set_xlabel("slots ahead")
            leads = {int(n) for row in figures[condition].values() for n in row.get(key, {})}
            axes.set_xticks(sorted(leads))
            axes.set_xlim(left=0)
            if key == "mpjpe_mm":
                axes.set_ylim(bottom=0)
            else:
                axes.set_ylim(top=1)
        legend_above(figure)


def draw_claims(path: Path, calibration: Mapping[str, Any]) -> None:
    """Draw actual against expected errors of predictors that state any; no file if none does.

    Args:
        path: the .svg file.
        calibration: condition -> predictor -> groups of joints.
    """
    if not any(calibration.values()):
        return
    with picture(path, PANEL_IN * 1.3, PANEL_IN * 1.3) as figure:
        axes = figure.subplots()
        _log(axes)
        axes.plot(TICKS_MM, TICKS_MM, color=INK, linewidth=0.8, linestyle=":", label="equal")
        number = 0
        for condition, predictors in calibration.items():
            for name, groups in predictors.items():
                joints = sum(group["joints"] for group in groups)
                shown = [g for g in groups if g["joints"] >= LEAST_SHARE * joints]
                axes.plot(
                    [group["expected_mm"] for group in shown],
                    [group["actual_mm"] for group in shown],
                    marker=MARKERS[number % len(MARKERS)],
                    linestyle=("-", "--", "-.")[number % 3],
                    color=colour_of(name, number),
                    label=f"{name}, {condition} histories",
                )
                number += 1
        axes.set_title("joints by the error that was expected")
        axes.legend(loc="upper left")


def _log(axes: Axes) -> None:
    limits = (TICKS_MM[0] * 0.8, TICKS_MM[-1])
    axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits, aspect="equal")
    axes.set(xlabel="expected, mm", ylabel="actual, mm")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:.0f}")
        axis.set_ticks(list(TICKS_MM))
        axis.set_ticks([], minor=True)
