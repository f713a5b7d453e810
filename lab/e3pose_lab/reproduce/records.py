"""Tables and charts of the report as plain records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import Literal

# Where a figure comes from. `simulated`: detections are simulated, on real or simulated motion.
Basis = Literal["paper", "measured", "modelled", "simulated"]
Kind = Literal["lines", "bars", "stacked", "points", "steps", "limbs"]


@dataclass(frozen=True, slots=True)
class Spread:
    """A mean over repetitions.

    Attributes:
        mean: of the repetitions.
        sd: their sample standard deviation; 0 for one repetition.
        count: how many there were.
    """

    mean: float
    sd: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the mean and spread of at least one value."""
        return cls(fmean(values), stdev(values) if len(values) > 1 else 0.0, len(values))


Cell = str | float | Spread | None


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        name: of its file.
        title: what it shows.
        columns: headings.
        rows: cells in the order of the columns; None where there is nothing to say.
        digits: decimals of numbers, of all columns or of each.
        folded: whether the report shows it only where it is asked for.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    digits: int | tuple[int, ...] = 1
    folded: bool = False


@dataclass(frozen=True, slots=True)
class Line:
    """One line, or one kind of bar, of a panel.

    Attributes:
        name: in the legend.
        basis: where its figures come from.
        x: places; names for bars and points.
        y: values; NaN leaves a gap.
        low: lower ends of an interval about each value; none if empty.
        high: upper ends likewise.
        second: drawn against the axis on the right; of limbs, dashed in ink over the others.
    """

    name: str
    basis: Basis
    x: tuple[float, ...] | tuple[str, ...]
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    second: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes.

    Attributes:
        name: of its file.
        title: above it.
        x_title: of the axis.
        y_title: likewise.
        lines: what it shows.
        kind: how it is drawn; `points` marks values above names where bars from 0 would hide what
            differs, `steps` shows which of some rows holds in each slot, `limbs` draws people as
            lines in the plane, y downward where it is pixels.
        y_second: title of the axis on the right.
        logarithmic: whether the x axis is.
        logarithmic_y: whether the y axis is.
        from_zero: whether the y axis of lines begins at 0, where small differences mean nothing.
        jpeg: of an image behind limbs, base64; none if empty.
        image_size: `(width, height)` of that image in the units of the axes.
    """

    name: str
    title: str
    x_title: str
    y_title: str
    lines: tuple[Line, ...]
    kind: Kind = "lines"
    y_second: str = ""
    logarithmic: bool = False
    logarithmic_y: bool = False
    from_zero: bool = False
    jpeg: str = ""
    image_size: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Headline:
    """A figure that must not move unnoticed.

    Attributes:
        name: what it is.
        value: found now.
        low: least that is accepted, by what was found here before.
        high: most that is accepted, likewise.
        paper: the paper's figure, or its range; None if it states none.
    """

    name: str
    value: float
    low: float
    high: float
    paper: float | tuple[float, float] | None = None

    @property
    def holds(self) -> bool:
        """Whether the value is within its margin."""
        return self.low <= self.value <= self.high

    @property
    def apart(self) -> float:
        """How far the value is above the paper's figure or range; NaN if it states none."""
        low, high = self.paper if isinstance(self.paper, tuple) else (self.paper, self.paper)
        if low is None or high is None:
            return float("nan")
        return min(self.value - low, 0.0) + max(self.value - high, 0.0)


@dataclass(frozen=True, slots=True)
class Section:
    """One item of the paper, redone.

    Attributes:
        paper: what the paper says, with its figures.
        ours: what is found here, in a sentence or two.
        why: why the two differ.
        how: how the figures came about: data, seeds, what is measured, modelled or simulated.
        tables: with the paper's figures beside ours.
        panels: likewise.
        headlines: figures with margins.
    """

    paper: str
    ours: str
    why: str
    how: str
    tables: tuple[Table, ...] = ()
    panels: tuple[Panel, ...] = ()
    headlines: tuple[Headline, ...] = ()
