"""Panels as SVG files in the style of the project's pictures."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from e3pose_lab.evaluate.drawing import COLOURS, INK, MARKERS, PALE, picture
from e3pose_lab.reproduce.records import Basis, Line, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_IN, HEIGHT_IN = 4.7, 3.3  # small enough to be read on a phone
IMAGE_HEIGHT_IN = 4.7  # of panels with an image, which may be upright
STYLES: dict[Basis, str] = {"paper": ":", "measured": "-", "modelled": "--", "simulated": "-."}
HATCHES: dict[Basis, str] = {
    "paper": "///",
    "measured": "",
    "modelled": "\\\\\\",
    "simulated": "xx",
}
ROOM = 0.8  # of the space between two groups of bars
LONG = 30  # characters of a legend's names beyond which two of them do not fit side by side
DENSE = 30  # values of a line beyond which marks would hide it


def draw(panel: Panel, path: Path) -> None:
    """Draw a panel into an .svg file."""
    with picture(path, WIDTH_IN, IMAGE_HEIGHT_IN if panel.jpeg else HEIGHT_IN) as figure:
        axes = figure.subplots()
        bases = {line.basis for line in panel.lines}
        one = len(bases) == 1
        basis = next(iter(bases))
        plain = panel.kind == "limbs" or not one or basis in panel.title
        axes.set_title(panel.title if plain else f"{panel.title} ({basis})")
        axes.set_xlabel(panel.x_title)
        axes.set_ylabel(panel.y_title)
        if panel.kind in ("bars", "stacked"):
            _bars(axes, panel, one)
        elif panel.kind == "points":
            _points(axes, panel, one)
        elif panel.kind in ("steps", "limbs"):
            (_steps if panel.kind == "steps" else _limbs)(axes, panel)
            return
        else:
            _lines(axes, panel, one)
        handles, labels = axes.get_legend_handles_labels()
        for other in figure.axes[1:]:
            more = other.get_legend_handles_labels()
            handles, labels = handles + more[0], labels + more[1]
        if len(labels) > 1 or not one:
            columns = 1 if max(map(len, labels)) > LONG else 2
            figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def _label(line: Line, one: bool) -> str:
    return line.name if one or line.basis in line.name else f"{line.name} ({line.basis})"


def _lines(axes: Axes, panel: Panel, one: bool) -> None:
    right = axes.twinx() if panel.y_second else None
    if right is not None:
        right.set_ylabel(panel.y_second)
        right.grid(visible=False)
        right.spines["right"].set_visible(True)
    for number, line in enumerate(panel.lines):
        place = right if line.second and right is not None else axes
        x = [float(value) for value in line.x]
        colour = PALE if line.basis == "paper" else COLOURS[number % len(COLOURS)]
        place.plot(
            x, line.y, STYLES[line.basis], color=colour, label=_label(line, one),
            marker="" if len(x) > DENSE else MARKERS[number % len(MARKERS)],
        )  # fmt: skip
        if line.low:
            place.fill_between(x, line.low, line.high, color=colour, alpha=0.15, linewidth=0)
    values = {float(x) for line in panel.lines for x in line.x}
    if len(values) < 8 and all(value == int(value) for value in values) and not panel.logarithmic:
        axes.set_xticks(sorted(values))
    if panel.logarithmic:
        axes.set_xscale("log")
    if panel.logarithmic_y:
        _logarithmic_y(axes, [value for line in panel.lines for value in line.y])
    if panel.from_zero:
        axes.set_ylim(0, 1.1 * axes.get_ylim()[1])


def _logarithmic_y(axes: Axes, values: Sequence[float]) -> None:
    """Scale the y axis, from one labelled value to another around those that are shown."""
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    shown = [value for value in values if value > 0 and np.isfinite(value)]
    ticks = [step * 10.0**power for power in range(-3, 6) for step in (1, 2, 5)]
    low = max((tick for tick in ticks if tick <= min(shown, default=1.0)), default=ticks[0])
    high = min((tick for tick in ticks if tick >= max(shown, default=10.0)), default=ticks[-1])
    axes.set_yscale("log")
    axes.set_ylim(low, max(high, 2 * low))
    axes.yaxis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _bars(axes: Axes, panel: Panel, one: bool) -> None:
    names = list(dict.fromkeys(str(name) for line in panel.lines for name in line.x))
    places = np.arange(len(names), dtype=np.float64)
    stacked = panel.kind == "stacked"
    width = ROOM if stacked else ROOM / len(panel.lines)
    bottom = np.zeros(len(names))
    for number, line in enumerate(panel.lines):
        values = dict(zip((str(x) for x in line.x), line.y, strict=True))
        heights = np.array([values.get(name, 0.0 if stacked else np.nan) for name in names])
        shift = 0.0 if stacked else width * (number - (len(panel.lines) - 1) / 2)
        axes.bar(
            places + shift, heights, width, bottom if stacked else 0.0,
            color=PALE if line.basis == "paper" else COLOURS[number % len(COLOURS)],
            hatch=HATCHES[line.basis], edgecolor="white", linewidth=0.5, label=_label(line, one),
        )  # fmt: skip
        if line.low:
            spread = np.abs(np.array([line.low, line.high]) - np.array(line.y))
            axes.errorbar(places + shift, heights, spread, fmt="none", ecolor=INK, capsize=2)
        bottom = bottom + np.nan_to_num(heights) * stacked
    long = max((len(name) for name in names), default=0) * len(names) > 50
    axes.set_xticks(places, names, rotation=30 if long else 0, ha="right" if long else "center")
    axes.grid(visible=False, axis="x")


def _points(axes: Axes, panel: Panel, one: bool) -> None:
    """Draw marks above names, those of one name side by side."""
    names = list(dict.fromkeys(str(name) for line in panel.lines for name in line.x))
    width = ROOM / len(panel.lines)
    for number, line in enumerate(panel.lines):
        shift = width * (number - (len(panel.lines) - 1) / 2)
        places = np.array([names.index(str(name)) + shift for name in line.x])
        colour = PALE if line.basis == "paper" else COLOURS[number % len(COLOURS)]
        spread = np.abs(np.array([line.low, line.high]) - np.array(line.y)) if line.low else None
        axes.errorbar(
            places, line.y, spread, fmt=MARKERS[number % len(MARKERS)], color=colour, capsize=2,
            markersize=6, label=_label(line, one),
        )  # fmt: skip
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=False, axis="x")


def _limbs(axes: Axes, panel: Panel) -> None:
    """Draw people to scale, over an image if there is one; NaN parts one limb from the next."""
    if panel.jpeg:
        from matplotlib.image import imread

        pixels = imread(BytesIO(b64decode(panel.jpeg)), format="jpeg")
        axes.imshow(
            pixels, extent=(-0.5, panel.image_size[0] - 0.5, panel.image_size[1] - 0.5, -0.5)
        )
        axes.set_axis_off()  # the image says what is right and down
    for number, line in enumerate(panel.lines):
        colour = INK if line.second else COLOURS[number % len(COLOURS)]
        style, width = ("--", 0.7) if line.second else ("-", 1.6)
        x = [float(value) for value in line.x]
        axes.plot(x, line.y, style, color=colour, linewidth=width, solid_capstyle="round")
    axes.set_aspect("equal", adjustable="box" if panel.jpeg else "datalim")
    if panel.jpeg:
        axes.set_xlim(-0.5, panel.image_size[0] - 0.5)
        axes.set_ylim(panel.image_size[1] - 0.5, -0.5)
    elif "px" in panel.y_title:
        axes.invert_yaxis()


def _steps(axes: Axes, panel: Panel) -> None:
    """Draw which of the rows hold when: a mark for each slot, a row for each line."""
    for line in panel.lines:
        axes.plot([float(x) for x in line.x], line.y, "|", color=COLOURS[0], markersize=5)
    axes.set_yticks(range(len(panel.lines)), [line.name for line in panel.lines])
    axes.invert_yaxis()
