"""Tables that fit the width of a terminal by wrapping columns into further tables."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

GAP = 2  # columns between two columns of a table


def table_console(width: int = 240) -> Console:
    """Return a console for tables: the terminal's width, and `width` for a file or a pipe."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else width)


def print_tables(
    console: Console,
    keys: Mapping[str, Sequence[str]],
    columns: Mapping[str, Sequence[str]],
    title: str = "",
    left: Collection[str] = (),
    apart: bool = False,
) -> None:
    """Print as many tables as it takes to show all columns in the width of a console.

    A single column wider than that is wrapped.

    Args:
        console: to print to.
        keys: heading to the cells of the columns that every table begins with.
        columns: heading to the cells of the others, right-aligned.
        title: of the first table.
        left: headings of columns of text, left-aligned.
        apart: an empty line follows each table.
    """
    width = console.width
    used = sum(_width(name, cells) + GAP for name, cells in keys.items())
    groups: list[list[str]] = [[]]
    room = width - used
    for name, cells in columns.items():
        needed = _width(name, cells) + GAP
        if groups[-1] and needed > room:
            groups.append([])
            room = width - used
        groups[-1].append(name)
        room -= needed
    for number, names in enumerate(groups):
        table = Table(
            title=title if number == 0 and title else None,
            title_justify="left",
            box=None,
            padding=(0, GAP, 0, 0),
            header_style="bold",
        )
        shown = {**keys, **{name: columns[name] for name in names}}
        for heading in shown:
            text = heading in left or (heading in keys and not left)
            table.add_column(
                Text(heading),
                justify="left" if text else "right",
                no_wrap=_width(heading, shown[heading]) + used <= width,
            )
        for row in zip(*shown.values(), strict=True):
            table.add_row(*(Text(cell) for cell in row))
        console.print(table)
        if apart:
            console.print()


def _width(heading: str, cells: Sequence[str]) -> int:
    return max(len(heading), *(len(cell) for cell in cells)) if cells else len(heading)
