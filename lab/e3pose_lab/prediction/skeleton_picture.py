"""Picture of predicted and actual skeletons, a row per window, a column per lead."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.quantities import plural
from e3pose.model.skeleton import BODY_LIMBS, Skeleton
from e3pose.predict.base import Predictor
from e3pose_lab.evaluate.drawing import INK, colour_of, legend_above, picture
from e3pose_lab.prediction.motion import BODY_JOINTS, body_joints
from e3pose_lab.prediction.windows import Window, foresee

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Maker = Callable[[str, Skeleton], Predictor]

LIMBS = [(BODY_JOINTS.index(a), BODY_JOINTS.index(b)) for a, b in (*BODY_LIMBS, ("neck", "head"))]
SHOWN_LEADS = (1, 5, 10, 15)
STILL_M = 0.15  # who moves less than this is seen from the front, others from the side
MARGIN_M = 0.1
CELL_IN, TEXT_IN = 1.9, 0.3
BAR_M = 0.5


def draw_skeletons(
    path: Path,
    chosen: Sequence[tuple[float, Window]],
    predictors: Sequence[str],
    leads: Sequence[int],
    make: Maker,
) -> None:
    """Draw what was predicted over what then happened, all cells in one scale.

    Args:
        path: the .svg file.
        chosen: share of the windows that are predicted better, and the window.
        predictors: names to draw, the most important first.
        leads: of the windows.
        make: returns a predictor for a skeleton.
    """
    columns = [lead for lead in SHOWN_LEADS if lead in leads] or list(leads)[:4]
    cells = [_project(window, predictors, leads, make) for _, window in chosen]
    spans = [_limits(cell) for cell in cells]
    width = max(high[0] - low[0] for low, high in spans) + 2 * MARGIN_M
    heights = [high[1] - low[1] + 2 * MARGIN_M for low, high in spans]
    inches = CELL_IN * sum(heights) / width + TEXT_IN * (len(chosen) + 1)
    with picture(path, CELL_IN * len(columns), inches) as figure:
        grid = figure.subplots(len(chosen), len(columns), squeeze=False, height_ratios=heights)
        for row, (share, window) in enumerate(chosen):
            low, high = spans[row]
            middle = (low[0] + high[0]) / 2
            for axes, lead in zip(grid[row], columns, strict=True):
                index = list(leads).index(lead)
                _bodies(axes, cells[row], index, predictors)
                axes.set_xlim(middle - width / 2, middle + width / 2)
                axes.set_ylim(low[1] - MARGIN_M, low[1] - MARGIN_M + heights[row])
                axes.set(aspect="equal", xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                if row == 0:
                    axes.set_title(
                        f"{plural(lead, 'slot')}, {1000 * lead * window.interval_s:.0f} ms"
                    )
                _print_errors(axes, cells[row], index, window, predictors)
            grid[row, 0].set_ylabel(f"{window.name}\n{share:.0%} go better", fontsize=8)
        _scale(grid[0, 0])
        legend_above(figure)


def _project(
    window: Window, predictors: Sequence[str], leads: Sequence[int], make: Maker
) -> Mapping[str, Floats]:
    """Return bodies in the plane of the picture, `(num_leads, 14, 2)` metres, and in the world."""
    newest = body_joints(window.history_m[-1], window.skeleton)
    across = _across(newest, window.future_m)
    seen = {"newest": newest[None], "actual": window.future_m}
    for name in predictors:
        seen[name] = foresee(window, make(name, window.skeleton), leads)
    flat = {
        name: np.stack([body_m @ across, body_m[..., 2]], axis=-1) for name, body_m in seen.items()
    }
    return flat | {f"{name} in the world": body_m for name, body_m in seen.items()}


def _across(newest: Floats, future_m: Floats) -> Floats:
    """Return the horizontal axis of the picture: where the person goes, or else their shoulders."""
    way = np.nanmean(future_m[-1], axis=0) - np.nanmean(newest, axis=0)
    if np.linalg.norm(way[:2]) < STILL_M:
        left, right = BODY_JOINTS.index("left_shoulder"), BODY_JOINTS.index("right_shoulder")
        way = future_m[-1, left] - future_m[-1, right]
        way = np.where(np.isfinite(way), way, np.array([1.0, 0.0, 0.0]))
    axis = np.array([way[0], way[1], 0.0])
    return np.asarray(axis / max(float(np.linalg.norm(axis)), 1e-9))


def _limits(cell: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    points = np.concatenate([b.reshape(-1, 2) for n, b in cell.items() if "world" not in n])
    return np.nanmin(points, axis=0), np.nanmax(points, axis=0)


def _bodies(axes: Axes, cell: Mapping[str, Floats], index: int, predictors: Sequence[str]) -> None:
    _body(axes, cell["newest"][0], "#d1d5db", 1.6, "newest that is known")
    _body(axes, cell["actual"][index], INK, 2.6, "actual")
    for number, name in reversed(list(enumerate(predictors))):
        _body(axes, cell[name][index], colour_of(name, number), 1.2, name)


def _body(axes: Axes, body: Floats, colour: str, width: float, label: str) -> None:
    """Draw one body `(14, 2)` as a single line with gaps, which keeps the file small."""
    lines = np.concatenate([[body[a], body[b], [np.nan, np.nan]] for a, b in LIMBS]).round(3)
    axes.plot(*lines.T, color=colour, linewidth=width, label=label, solid_capstyle="round")


def _print_errors(
    axes: Axes, cell: Mapping[str, Floats], index: int, window: Window, predictors: Sequence[str]
) -> None:
    """Write the mean error of each predictor below the bodies, in its colour."""
    for number, name in enumerate(predictors):
        off = np.linalg.norm(cell[f"{name} in the world"][index] - window.future_m[index], axis=-1)
        place = (number + 1) / (len(predictors) + 1)
        axes.text(
            place,
            0.0,
            f"{1000 * np.nanmean(off):.0f} mm",
            color=colour_of(name, number),
            transform=axes.transAxes,
            fontsize=8,
            ha="center",
            va="top",
        )


def _scale(axes: Axes) -> None:
    (left, _), (low, _) = axes.get_xlim(), axes.get_ylim()
    axes.plot([left, left + BAR_M], [low + 0.03] * 2, color=INK, linewidth=1.0)
    axes.annotate(f"{BAR_M:g} m", (left, low + 0.05), fontsize=7, va="bottom")
