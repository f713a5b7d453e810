"""A noise calibration as a file, as tables and as a picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.model.noises import NoiseFile, ViewFigures
from e3pose.model.noises.file import FORMAT, VERSION
from e3pose_lab.evaluate.drawing import COLOURS, INK, PALE, legend_above, picture
from e3pose_lab.noise.calibrate import Calibrated

if TYPE_CHECKING:
    from rich.console import Console

MAX_SOURCE = 500


def as_file(calibrated: Calibrated, rig: Rig, detector: str, source: str) -> NoiseFile:
    """Return the noise file of a calibration.

    Args:
        calibrated: what was measured.
        rig: the cameras, for their names.
        detector: whose keypoints they were.
        source: of the recording.
    """
    measured = calibrated.measured
    said = " ".join(source.split())[:MAX_SOURCE]
    slots, tracks = plural(calibrated.slots, "slot"), plural(calibrated.people, "track")
    how_much = f"{slots}, {tracks} and {plural(len(rig), 'camera')}"
    return NoiseFile(
        format=FORMAT,
        version=VERSION,
        detector=detector,
        basis="measured",
        source=f"Measured on {how_much} of: {said}",
        image_px=calibrated.noise.image_px,
        scores=_rounded(calibrated.noise.scores.tolist(), 4),
        sigma_px=_rounded(calibrated.noise.sigma_px.tolist(), 3),
        measured_px=_rounded(measured.sigma_px.tolist(), 3),
        gross_share=_rounded(measured.gross_share.tolist(), 5),
        counts=measured.counts.tolist(),
        memory=_rounded_memory(calibrated.noise.memory),
        views={
            rig.camera_ids[camera]: ViewFigures(
                view.keypoints,
                round(view.sigma_px, 3),
                round(view.gross_share, 5),
                round(view.bias_px, 3),
                _pair(view.shift_px + calibrated.shifts_px[camera]),
            )
            for camera, view in measured.views.items()
        },
    )


def print_noise(
    file: NoiseFile,
    correlations: dict[float, float],
    console: Console,
    learned: Mapping[str, float],
    shipped: str,
) -> None:
    """Print sigma and gross errors by score, the memory of errors, and every camera.

    Args:
        file: what was measured.
        correlations: by lag in seconds.
        console: where to.
        learned: by camera, what the estimator found while it ran: sigma over that of the shipped
            noise; NaN where it saw too little.
        shipped: the name of that noise.
    """
    table = Table("score", "keypoints", "sigma, px", "measured, px", "gross, %")
    for row in zip(
        file.scores, file.counts, file.sigma_px, file.measured_px, file.gross_share, strict=True
    ):
        score, count, sigma, measured, gross = row
        table.add_row(
            f"{score:.2f}", str(count), f"{sigma:.2f}", f"{measured:.2f}", f"{100 * gross:.1f}"
        )
    _print(table, f"{file.detector}: errors by score, images of {file.image_px:g} px", console)
    lags = Table("seconds apart", *(f"{lag:.2f}" for lag in correlations))
    lags.add_row("correlation", *(f"{value:.2f}" for value in correlations.values()))
    _print(lags, "errors of a joint in a view, later ones with earlier ones, measured", console)
    parts = Table(
        "errors", *(f"{lasts_s:g} s" if lasts_s else "new" for _, lasts_s in file.memory.parts)
    )
    parts.add_row("share, %", *(f"{100 * share:.0f}" for share, _ in file.memory.parts))
    _print(parts, "how long errors last, shares of their variance, corrected", console)
    views = Table(
        "camera", "keypoints", "sigma, px", "bias of a joint, px", "shift, px", "gross, %", "live"
    )
    for name, view in file.views.items():
        right, down = view.shift_px
        views.add_row(
            name,
            str(view.keypoints),
            f"{view.sigma_px:.2f}",
            f"{view.bias_px:.2f}",
            f"{right:+.1f} right, {down:+.1f} down",
            f"{100 * view.gross_share:.1f}",
            f"{learned[name]:.1f}x {shipped}" if learned[name] > 0 else "",
        )
    _print(views, "by camera, measured, all scores", console)
    console.print(
        Text(
            "sigma: of either coordinate, corrected for the error of the reference; gross: beyond "
            "40 px of 1032; bias: mean over time; "
            "live: noise learned online relative to the initial model"
        )
    )


def draw_noise(
    path: Path, file: NoiseFile, correlations: dict[float, float], beside: NoiseFile | None = None
) -> None:
    """Draw sigma and gross errors by score, and how long errors last.

    Args:
        path: the .svg file.
        file: what was measured.
        correlations: by lag in seconds.
        beside: another noise to draw the sigma of, such as the one shipped for the detector.
    """
    with picture(path, 8.7, 3.0) as figure:
        by_score, gross, memory = figure.subplots(1, 3)
        by_score.plot(file.scores, file.measured_px, color=PALE, marker="s", label="measured")
        by_score.plot(
            file.scores,
            file.sigma_px,
            color=COLOURS[0],
            marker="o",
            label="corrected for the reference",
        )
        if beside is not None:
            scale = file.image_px / beside.image_px
            by_score.plot(
                beside.scores,
                [scale * sigma for sigma in beside.sigma_px],
                color=COLOURS[1],
                linestyle="--",
                label=f"shipped for {beside.detector}",
            )
        by_score.set_title(f"sigma, px of {file.image_px:g}")
        gross.bar(
            file.scores, [100 * share for share in file.gross_share], width=0.05, color=COLOURS[0]
        )
        gross.set_title("gross errors, %")
        memory.plot([0.0, *correlations], [1.0, *correlations.values()], color=INK, marker="o")
        memory.set_title("correlation of errors")
        memory.set_xlabel("seconds apart")
        for axes in (by_score, gross):
            axes.set_xlabel("score")
            axes.set_xlim(0, 1)
        legend_above(figure)
        for axes in figure.axes:
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0] if axes is memory else 0.0))


def _rounded(values: Iterable[float], digits: int) -> list[float]:
    return [round(value, digits) for value in values]


def _rounded_memory(memory: ErrorMemory) -> ErrorMemory:
    lasting = round(memory.lasting_share, 3)
    quick = min(round(memory.quick_share, 3), round(1 - lasting, 3))
    return replace(memory, lasting_share=lasting, quick_share=quick)


def _pair(shift_px: NDArray[np.float64]) -> tuple[float, float]:
    right, down = shift_px.round(2).tolist()
    return right, down


def _print(table: Table, title: str, console: Console) -> None:
    for column in table.columns[1:]:
        column.justify = "right"
    console.print(Text(title, style="italic"))
    console.print(table)
