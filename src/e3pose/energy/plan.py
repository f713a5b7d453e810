"""Boards, cameras and running times: from published power and measured errors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from e3pose.base.bounded import read_shipped
from e3pose.base.errors import InputError
from e3pose.base.table import entry, read_table
from e3pose.energy.profiles import MAX_BYTES, PROFILES, load_profile

# By how much poses of a sensor that detects are worse: 1.7 to 2.1 in eight simulated rooms with the
# noise of an AI Camera (lab/benchmarks/sensor_noise.py).
SENSOR_ERROR = 1.8
LEAST_RECALL = 0.9  # a plan that loses more people than that is none


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A published figure, watts or seconds."""

    value: Annotated[float, Meta(ge=0, le=10_000)]
    source: str
    date: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """One board or camera; a figure that nobody published is None.

    Attributes:
        name: short.
        title: for people.
        detects: whether its sensor finds the poses.
        poses: whether a network for several people is known to run on it.
        idle: watts without a look.
        busy: watts while it looks all the time.
        sleep: watts as low as it can be woken from by itself.
        wake: seconds from there to the first frame.
    """

    name: str
    title: str
    detects: bool = False
    poses: bool = True
    idle: Figure | None = None
    busy: Figure | None = None
    sleep: Figure | None = None
    wake: Figure | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Boards:
    board: tuple[Board, ...] = entry()


@dataclass(frozen=True, slots=True)
class Reach:
    """The fewest looks that reach an error, as measured.

    Attributes:
        cameras: of the site.
        active: of them in a slot, on average.
        error_mm: expected.
    """

    cameras: int
    active: float
    error_mm: float


@dataclass(frozen=True, slots=True)
class PlanRow:
    """The running time of a site of one board.

    Attributes:
        board: which.
        reach: cameras and looks; None where no measured number of them reaches the error.
        watts: least and most of each camera, equal where both its figures are known; None where
            neither end is.
        hours: likewise of a battery.
    """

    board: Board
    reach: Reach | None
    watts: tuple[float | None, float | None]
    hours: tuple[float | None, float | None]


def load_boards() -> tuple[Board, ...]:
    """Return the boards of the table that comes with the package, then the power profiles."""
    table, _ = read_shipped("boards", "e3pose.energy", ("boards",), "boards", MAX_BYTES)
    boards = read_table(_Boards, table).board
    return (*boards, *(profile_board(name) for name in PROFILES))


def profile_board(name: str) -> Board:
    """Return a board by its power profile, one that comes with the package or a file."""
    profile, source = load_profile(name), f"power profile {name}, whose figures name theirs"
    idle = Figure(value=profile.watts("power-saving"), source=source, date="")
    busy = Figure(value=profile.watts("active"), source=source, date="")
    return Board(name=profile.name, title=profile.title, idle=idle, busy=busy)


def reaches(people: int, error_mm: float) -> list[Reach]:
    """Return for each measured number of cameras the fewest active ones that reach an error.

    Args:
        people: in the room; the next larger number that was measured is taken.
        error_mm: mean distance of joints.

    Raises:
        InputError: for more people than were measured.
    """
    rows: list[tuple[int, int, float, float, float]] = json.loads(
        (resources.files("e3pose.energy") / "frontier.json").read_text(encoding="utf-8")
    )["rows"]
    measured = sorted({row[0] for row in rows})
    if people < 1 or people > measured[-1]:
        raise InputError("people", people, f"1 to {measured[-1]}, as measured")
    taken = next(each for each in measured if each >= people)
    found = []
    for cameras in sorted({row[1] for row in rows}):
        curve = np.array(
            [
                row[2:4]
                for row in rows
                if (row[0], row[1]) == (taken, cameras) and row[4] >= LEAST_RECALL
            ]
        ).reshape(-1, 2)
        if not len(curve) or curve[:, 1].min() > error_mm:
            continue
        active, errors = curve[:, 0], np.minimum.accumulate(curve[:, 1])
        least = float(np.interp(-error_mm, -errors, active))
        found.append(Reach(cameras, least, float(np.interp(least, active, errors))))
    return found


def plan(
    boards: Sequence[Board],
    people: int,
    error_mm: float,
    battery_wh: float | None,
    cameras: int | None = None,
) -> list[PlanRow]:
    """Return the needs of each board and the life of its battery, the longest first.

    A camera draws `busy` in the slots in which it looks and `idle` in the others.

    Args:
        boards: to compare.
        people: in the room.
        error_mm: to reach.
        battery_wh: of each camera; None on mains.
        cameras: of the site; by default the fewest that reach the error.
    """
    rows = []
    for board in boards:
        worse = SENSOR_ERROR if board.detects else 1.0
        found = [each for each in reaches(people, error_mm / worse)
                 if board.poses and cameras in (None, each.cameras)]  # fmt: skip
        reach = found[0] if found else None
        share = 1.0 if reach is None else reach.active / reach.cameras
        idle = None if board.idle is None else board.idle.value
        busy = None if board.busy is None else board.busy.value
        low, high = idle, busy  # the ends that are known
        if idle is not None and busy is not None:
            low = high = idle + share * (busy - idle)
        long = None if not low or battery_wh is None else battery_wh / low
        short = None if not high or battery_wh is None else battery_wh / high
        rows.append(PlanRow(board, reach, (low, high), (short, long)))
    return sorted(rows, key=lambda row: (row.reach is None, -(row.hours[1] or row.hours[0] or 0)))


def draw(rows: Sequence[PlanRow], title: str, path: Path) -> None:
    """Draw how long the battery of each board lasts; from the least to the most where one is open.

    Args:
        rows: with hours.
        title: of the picture.
        path: of a PNG, SVG or PDF file.
    """
    from matplotlib.figure import Figure as Picture

    shown = [row for row in rows if row.reach is not None and any(row.hours)][::-1]
    picture = Picture(figsize=(9, 1.5 + 0.4 * len(shown)), layout="constrained")
    axes = picture.subplots()
    for place, row in enumerate(shown):
        short, long = row.hours
        known = short or long or 0.0
        axes.barh(place, known, color="tab:blue" if short == long else "tab:orange")
        axes.text(known, place, f" {hours_text(row)}", va="center")
    axes.set_yticks(range(len(shown)), [row.board.title for row in shown])
    axes.set_xlabel("hours")
    axes.set_xmargin(0.15)
    axes.set_title(title)
    picture.savefig(path)


def hours_text(row: PlanRow) -> str:
    """Return how long its battery lasts, in words: `unknown` where no end is published."""
    short, long = row.hours
    if row.reach is None:
        return "out of reach" if row.board.poses else "no network of several people"
    if short is None and long is None:
        return "mains" if any(row.watts) else "unknown"
    if short == long:
        return f"{long:.3g} h"
    return f"at most {long:.3g} h" if long is not None else f"at least {short:.3g} h"
