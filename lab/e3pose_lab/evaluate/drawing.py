"""SVG pictures in one style, byte-identical for the same numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, PALE = "#1f2937", "#9ca3af"
# Okabe and Ito's colours, which people who see fewer colours can tell apart.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("o", "s", "^", "D", "v", "P")
TAG = re.compile(r"<[^>]*>")  # what stands between them is text that people read
DECIMALS = re.compile(r"(\d\.\d\d)\d+")  # a hundredth of a point is finer than any screen

STYLE: Mapping[str, Any] = {
    "svg.fonttype": "none",  # letters stay letters: a tenth of the size, and they can be searched
    "svg.hashsalt": "e3pose",  # ids inside the file would be random
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial"],
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.edgecolor": PALE,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e5e7eb",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "white",  # also on a page that is dark
}


PREDICTOR_COLOURS: Mapping[str, str] = {
    "attention-lstm": COLOURS[0],
    "constant-velocity": COLOURS[1],
    "damped-velocity": COLOURS[2],
    "zero-velocity": PALE,
}


def colour_of(predictor: str, index: int) -> str:
    """Return the colour of a predictor, the same in every picture."""
    return PREDICTOR_COLOURS.get(predictor, COLOURS[3 + index % 3])


def check_svg(option: str, path: Path) -> None:
    """Raise `InputError` unless a picture can be written at `path`."""
    if path.suffix.lower() != ".svg":
        raise InputError(f"{option}: found {path.name!r}, expected a name that ends in .svg")


@contextmanager
def picture(path: Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """Yield an empty figure; it is written to `path` if the block ends without error.

    Args:
        path: the .svg file.
        width_in: width in inches of 72 points.
        height_in: height likewise.
    """
    import matplotlib
    from matplotlib.figure import Figure  # not pyplot: no window, no state beyond this block

    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        yield figure
        with atomic_file(path) as temporary:
            figure.savefig(temporary, format="svg", metadata={"Date": None, "Creator": None})
            text = temporary.read_text(encoding="utf-8")
            short = TAG.sub(lambda tag: DECIMALS.sub(r"\1", tag[0]), text)
            temporary.write_text(short, encoding="utf-8")


def legend_above(figure: Figure, columns: int = 6) -> None:
    """Explain the lines of all panels once, above them."""
    lines: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            lines.setdefault(label, handle)
    figure.legend(lines.values(), lines.keys(), loc="outside upper left", ncols=columns)
