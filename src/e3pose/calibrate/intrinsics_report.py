"""Report on intrinsics: lines, plain values and a picture of the coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.calibrate.board_views import BoardViews
from e3pose.calibrate.intrinsics import Intrinsics
from e3pose.calibrate.view_choice import GRID, advice, covered

if TYPE_CHECKING:
    from matplotlib.axes import Axes


GOOD_PX = 0.5  # a sharp board seen by a still camera is below this
POOR_PX = 1.5
UNSURE_FOCAL = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class LensReport:
    """One camera's intrinsics and the views behind them.

    Attributes:
        views: where the board was found.
        fit: what they say.
        next_steps: what to record for a better result, in words.
    """

    views: BoardViews
    fit: Intrinsics
    next_steps: list[str]


def make_report(views: BoardViews, fit: Intrinsics, corners_m: Floats) -> LensReport:
    """Judge a fit and say what to record next."""
    words = advice(corners_m, views.corners_px[fit.used], views.image_size)
    error = fit.held_out_px[fit.model]
    if error > POOR_PX:
        words.insert(
            0,
            f"the error of {error:.1f} px is high: keep the board flat (glue it to a plate), move "
            "it slowly or hold it still, and lock focus and zoom",
        )
    if fit.focal_sigma > UNSURE_FOCAL and not words:
        words.append("the focal length is unsure: add views with the board tilted and near")
    return LensReport(views, fit, words)


def as_values(report: LensReport) -> dict[str, Any]:
    """Return a report as plain values for JSON."""
    fit, views = report.fit, report.views
    K = fit.camera.K
    return {
        "camera": views.camera_id,
        "image_size": list(views.image_size),
        "model": fit.model,
        "focal_px": [float(K[0, 0]), float(K[1, 1])],
        "focal_sigma_px": float(fit.focal_sigma * K[0, 0]),
        "principal_point_px": [float(K[0, 2]), float(K[1, 2])],
        "distortion": fit.camera.distortion.tolist(),
        "known_to_deg": None
        if fit.camera.known_to is None
        else float(np.degrees(fit.camera.known_to)),
        "reprojection_error_px": fit.fit_px,
        "held_out_error_px": {
            name: None if np.isnan(value) else value for name, value in fit.held_out_px.items()
        },
        "frames_searched": views.searched,
        "frames_with_board": len(views.times_s),
        "frames_used": len(fit.used),
        "corners_by_part": covered(views.corners_px[fit.used], views.image_size).tolist(),
        "next": report.next_steps,
    }


def as_lines(report: LensReport) -> list[str]:
    """Return a report as lines of at most about 100 characters."""
    fit, views = report.fit, report.views
    K, (width, height) = fit.camera.K, views.image_size
    view = np.degrees(2 * np.arctan(width / 2 / K[0, 0]))
    parts = covered(views.corners_px[fit.used], views.image_size)
    others = ", ".join(
        f"{name} {'no fit' if np.isnan(value) else f'{value:.2f}'}"
        for name, value in fit.held_out_px.items()
        if name != fit.model
    )
    angle = "fisheye lens" if fit.model == "fisheye" else f"{view:.0f} degrees across"
    lines = [
        f"{views.camera_id}: {width} x {height}, {angle}",
        f"  focal length {K[0, 0]:.1f} +- {fit.focal_sigma * K[0, 0]:.1f} px, "
        f"principal point {K[0, 2]:.1f} {K[1, 2]:.1f}",
        f"  reprojection error {fit.held_out_px[fit.model]:.2f} px in held-out views "
        f"({fit.fit_px:.2f} in the fit): {_verdict(fit.held_out_px[fit.model])}",
        f"  lens {fit.model}{f' (held-out px of others: {others})' if others else ''}",
        f"  board in {len(views.times_s)} of {views.searched} frames, {len(fit.used)} used; "
        f"corners in {int((parts >= 4).sum())} of {GRID[0] * GRID[1]} parts of the picture",
    ]
    if fit.camera.known_to is not None:
        lines.append(
            f"  known up to {np.degrees(fit.camera.known_to):.0f} degrees off the axis, where the "
            "board was seen; farther out nothing is placed"
        )
    lines += [f"  next: {words}" for words in report.next_steps]
    return lines


def _verdict(error_px: float) -> str:
    if error_px <= GOOD_PX:
        return "good"
    return "usable" if error_px <= POOR_PX else "poor"


def draw_coverage(path: Path, reports: Sequence[LensReport]) -> None:
    """Draw where each picture was covered and how large errors are there, as .png or .svg."""
    from matplotlib.figure import Figure

    columns = min(len(reports), 3)
    rows = -(-len(reports) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, report in zip(axes, reports, strict=False):
        _draw_one(place, report)
    for place in axes[len(reports) :]:
        place.set_axis_off()
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=130)


def _draw_one(axes: Axes, report: LensReport) -> None:
    fit, (width, height) = report.fit, report.views.image_size
    used = report.views.corners_px[fit.used]
    seen = used[np.isfinite(used[..., 0])]
    errors = fit.errors_px[np.isfinite(used[..., 0])]
    dots = axes.scatter(
        seen[:, 0], seen[:, 1], c=errors, s=7, cmap="viridis", vmin=0, vmax=max(1.0, 2 * fit.fit_px)
    )
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(dots, ax=axes, label="error, px", shrink=0.8)
    for share in range(1, GRID[0]):
        axes.axvline(width * share / GRID[0], color="#d1d5db", lw=0.8)
    for share in range(1, GRID[1]):
        axes.axhline(height * share / GRID[1], color="#d1d5db", lw=0.8)
    for y, x in np.argwhere(covered(used, report.views.image_size) < 4).tolist():
        axes.text(
            (x + 0.5) * width / GRID[0], (y + 0.5) * height / GRID[1], "no\ncorners",
            ha="center", va="center", color="#d55e00", fontsize=8,
        )  # fmt: skip
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set_title(
        f"{report.views.camera_id}: {fit.model}, {len(fit.used)} views, "
        f"{fit.held_out_px[fit.model]:.2f} px", fontsize=9,
    )  # fmt: skip
    axes.tick_params(labelsize=7)
