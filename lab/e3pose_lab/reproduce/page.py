"""Sections as a self-contained HTML page, and as SVG and CSV files."""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from math import isfinite
from pathlib import Path
from string import Template

from e3pose.base.atomic import atomic_file, write_file
from e3pose.base.quantities import plural
from e3pose_lab.reproduce.draw import draw
from e3pose_lab.reproduce.items import Item
from e3pose_lab.reproduce.records import Cell, Headline, Panel, Section, Spread, Table

FIGURES, TABLES = "figures", "tables"
MISSING = "–"
CODE = re.compile(r"`([^`]+)`")


@dataclass(frozen=True, slots=True)
class Part:
    """An item with its section, or with the reason why it has none."""

    item: Item
    section: Section | None
    skipped: str = ""


def write_page(folder: Path, parts: Sequence[Part], about: Mapping[str, str], quick: bool) -> Path:
    """Write report.html, and figures and tables as files of their own.

    Args:
        folder: where to.
        parts: in order.
        about: versions, machine and settings.
        quick: whether this was a quick run.
    """
    drawn = [part for part in parts if part.section is not None]
    headlines = [h for part in drawn if part.section for h in part.section.headlines]
    template = resources.files("e3pose_lab.reproduce").joinpath("page.html")
    page = Template(template.read_text(encoding="utf-8")).substitute(
        summary=escape(_summary(parts, headlines)),
        quick="<b>This is a quick run: few seeds and slots, to see that everything works.</b>"
        if quick
        else "",
        contents="".join(
            f'<li><a href="#{part.item.key}">{escape(part.item.title)}</a></li>' for part in parts
        ),
        sections="".join(_section(folder, part) for part in parts),
        headlines="".join(_headline(headline) for headline in headlines),
        about="".join(
            f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>"
            for key, value in about.items()
        ),
    )
    path = folder / "report.html"
    write_file(path, page)
    return path


def _summary(parts: Sequence[Part], headlines: Sequence[Headline]) -> str:
    done = sum(part.section is not None for part in parts)
    wrong = [headline.name for headline in headlines if not headline.holds]
    said = f"{done} of {len(parts)} items were computed"
    skipped = [part.item.title for part in parts if part.section is None]
    said += f"; skipped: {', '.join(skipped)}. " if skipped else ". "
    if wrong:
        return f"{said}Not what was found here before: {'; '.join(wrong)}."
    if not headlines:
        return said
    alike = plural(len(headlines), "headline figure is", "headline figures are")
    stated = [headline for headline in headlines if headline.paper is not None]
    return (
        f"{said}{alike} what this system found before, within margins. "
        f"{plural(len(stated), 'has', 'have')} a figure of the paper beside."
    )


def _section(folder: Path, part: Part) -> str:
    item, section = part.item, part.section
    label = f"{item.label} in the paper's source" if item.label else "not in the paper"
    head = (
        f'<section id="{item.key}"><h2>{escape(item.title)}</h2><p class="soft">{escape(label)}</p>'
    )
    if section is None:
        return f"{head}<p>Skipped: {_prose(part.skipped)}</p></section>"
    words = (
        ("Paper", section.paper), ("Here", section.ours), ("Why", section.why),
        ("How", section.how),
    )  # fmt: skip
    said = "".join(f"<dt>{name}</dt><dd>{_prose(text)}</dd>" for name, text in words if text)
    charts = "".join(_chart(folder, panel) for panel in section.panels)
    tables = "".join(_table(folder, table) for table in section.tables)
    return f'{head}<dl>{said}</dl><div class="charts">{charts}</div>{tables}</section>'


def _prose(text: str) -> str:
    """Return text as HTML, with what stands in backticks as code."""
    return CODE.sub(r"<code>\1</code>", escape(text))


def _chart(folder: Path, panel: Panel) -> str:
    path = folder / FIGURES / f"{panel.name}.svg"
    draw(panel, path)
    rows: list[list[str]] = [["line", "basis", "x", "y", "low", "high"]]
    for line in panel.lines:
        low = line.low or ("",) * len(line.x)
        high = line.high or ("",) * len(line.x)
        for values in zip(line.x, line.y, low, high, strict=True):
            rows.append([line.name, line.basis, *(str(value) for value in values)])
    _write_csv(path.with_suffix(".csv"), rows)
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    against = f" against {panel.x_title}" if panel.x_title else ""
    alt = escape(f"{panel.title}: {panel.y_title}{against}", quote=True)
    return f'<figure><img alt="{alt}" src="data:image/svg+xml;base64,{data}"></figure>'


def _table(folder: Path, table: Table) -> str:
    wide = [
        any(isinstance(row[n], Spread) for row in table.rows) for n in range(len(table.columns))
    ]
    header: list[str] = []
    for name, spread in zip(table.columns, wide, strict=True):
        header += [name, f"{name}, standard deviation"] if spread else [name]
    rows = [header]
    for row in table.rows:
        cells: list[str] = []
        for cell, spread in zip(row, wide, strict=True):
            mean = cell.mean if isinstance(cell, Spread) else cell
            cells.append("" if mean is None else str(mean))
            if spread:  # nothing where there was one repetition
                cells.append(str(cell.sd) if isinstance(cell, Spread) and cell.count > 1 else "")
        rows.append(cells)
    _write_csv(folder / TABLES / f"{table.name}.csv", rows)
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    many = len(table.columns)
    digits = (table.digits,) * many if isinstance(table.digits, int) else table.digits
    body = "".join(
        "<tr>"
        + "".join(
            f"<td>{escape(shown(cell, places))}</td>"
            for cell, places in zip(row, digits, strict=True)
        )
        + "</tr>"
        for row in table.rows
    )
    whole = f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'
    title = escape(table.title)
    if table.folded:
        return f"<details><summary>{title}</summary>{whole}</details>"
    return f"<h3>{title}</h3>{whole}"


def shown(cell: Cell, digits: int) -> str:
    """Return a cell as text; what is missing as a dash."""
    if isinstance(cell, Spread):
        spread = f" ± {cell.sd:.{digits}f}" if cell.count > 1 else ""
        return f"{_rounded(cell.mean, digits)}{spread}" if isfinite(cell.mean) else MISSING
    if isinstance(cell, float | int):
        return _rounded(cell, digits) if isfinite(cell) else MISSING
    return MISSING if cell is None else cell


def _rounded(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}"  # without the sign of -0.0


def _headline(headline: Headline) -> str:
    mark = "" if headline.holds else ' class="bad"'
    paper = headline.paper
    ends = paper if isinstance(paper, tuple) else () if paper is None else (paper,)
    theirs = " to ".join(f"{end:g}" for end in ends) or MISSING
    apart = f"{headline.apart + 0.0:+.2f}" if ends else MISSING
    return (
        f"<tr><td>{escape(headline.name)}</td><td{mark}>{headline.value:.2f}</td>"
        f"<td>{theirs}</td><td>{apart}</td>"
        f"<td>{headline.low:g} to {headline.high:g}</td></tr>"
    )


def _write_csv(path: Path, rows: Sequence[Sequence[str]]) -> None:
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
