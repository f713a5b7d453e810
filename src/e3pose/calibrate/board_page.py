"""A board as a page to print, at true scale: the same rectangles as SVG and as PDF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.calibrate.board import CELLS, Board

PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
MARGIN_MM = 11.0  # printers leave this much white, and detectors need it around the board
FOOT_MM = 20.0  # for the words and the bar
BAR_MM = 100.0
POINTS_PER_MM = 72 / 25.4


@dataclass(frozen=True, slots=True)
class Box:
    """A black rectangle in millimetres from the page's top left corner."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text; `x` and `y` in millimetres of its baseline's left end."""

    x: float
    y: float
    text: str


@dataclass(frozen=True, slots=True)
class Page:
    """A page in millimetres."""

    width: float
    height: float
    boxes: tuple[Box, ...]
    lines: tuple[Line, ...]


def largest_square_mm(paper: str, columns: int, rows: int) -> int:
    """Return the side of the largest squares, in whole millimetres, that fit on a paper."""
    width, height = paper_mm(paper)
    return int(min((width - 2 * MARGIN_MM) / columns, (height - 2 * MARGIN_MM - FOOT_MM) / rows))


def paper_mm(paper: str) -> tuple[float, float]:
    """Return width and height of an upright paper.

    Raises:
        InputError: for a paper that is not one of `PAPERS_MM`.
    """
    if paper.lower() not in PAPERS_MM:
        raise InputError(f"paper: found {paper[:20]!r}, expected one of {', '.join(PAPERS_MM)}")
    return PAPERS_MM[paper.lower()]


def draw_page(board: Board, paper: str, back: bool = False) -> Page:
    """Lay a board out on a paper, with a bar to measure and the name that `Board.parse` reads.

    Args:
        board: what to draw.
        paper: one of `PAPERS_MM`.
        back: whether to draw the mirror image, for the back of a two-sided board.

    Raises:
        InputError: when the board does not fit the paper, or the paper is unknown.
    """
    board.check_oriented()
    width, height = paper_mm(paper)
    square = 1000 * board.square_m
    board_width, board_height = square * board.columns, square * board.rows
    room = (width - 2 * MARGIN_MM, height - 2 * MARGIN_MM - FOOT_MM)
    if board_width > room[0] + 1e-6 or board_height > room[1] + 1e-6:
        raise InputError(
            f"board: {board.columns}x{board.rows} squares of {square:g} mm take "
            f"{board_width:g} x {board_height:g} mm, expected at most {room[0]:.0f} x "
            f"{room[1]:.0f} mm on {paper}; take smaller or fewer squares"
        )
    left, top = (width - board_width) / 2, MARGIN_MM + (room[1] - board_height) / 2
    cell = square / CELLS
    boxes = [
        Box(left + x0 * cell, top + y0 * cell, (x1 - x0) * cell, (y1 - y0) * cell)
        for y0, y1, x0, x1 in _rectangles(board.cells()[:, :: -1 if back else 1])
    ]
    foot = height - MARGIN_MM - FOOT_MM + 8.0
    bar = (width - BAR_MM) / 2
    boxes += [
        Box(bar, foot, BAR_MM, 0.4),
        Box(bar, foot - 1.5, 0.4, 3.4),
        Box(bar + BAR_MM - 0.4, foot - 1.5, 0.4, 3.4),
    ]
    lines = (
        Line(bar, foot + 5.5, f"{board.name}: print at 100 % (no fit to page). This bar is"),
        Line(bar, foot + 9.5, f"{BAR_MM:g} mm from end to end; if not, measure a square and pass"),
        Line(bar, foot + 13.5, f"--board {_with_side(board)}"),
    )
    return Page(width, height, tuple(boxes), lines)


def _with_side(board: Board) -> str:
    """Return the board's name with a place for the side of its squares."""
    side = f"{1000 * board.square_m:.6g}mm"
    return board.name.replace(side, "<its side>mm", 1)


def _rectangles(cells: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Yield few rectangles (row, end row, column, end column) that cover the black cells.

    Runs of a row that the next row repeats become one rectangle: printers draw hairlines between
    rectangles that merely touch.
    """
    open_runs: dict[tuple[int, int], int] = {}
    for row in range(len(cells) + 1):
        line = cells[row] if row < len(cells) else np.zeros(cells.shape[1], dtype=bool)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(np.int8), [0]])))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for run in sorted(set(open_runs) - runs):
            yield open_runs.pop(run), row, *run
        for run in runs - set(open_runs):
            open_runs[run] = row


def as_svg(page: Page) -> str:
    """Return a page as SVG, one user unit a millimetre."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width:g}mm" '
        f'height="{page.height:g}mm" viewBox="0 0 {page.width:g} {page.height:g}">',
        f'<rect width="{page.width:g}" height="{page.height:g}" fill="white"/>',
        '<g shape-rendering="crispEdges">',
    ]
    parts += [
        f'<rect x="{b.x:.4f}" y="{b.y:.4f}" width="{b.width:.4f}" height="{b.height:.4f}"/>'
        for b in page.boxes
    ]
    parts.append('</g><g font-family="Helvetica, Arial, sans-serif" font-size="3.2">')
    escaped = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
    for line in page.lines:
        text = "".join(escaped.get(char, char) for char in line.text)
        parts.append(f'<text x="{line.x:.2f}" y="{line.y:.2f}">{text}</text>')
    return "\n".join([*parts, "</g></svg>\n"])


def as_pdf(page: Page) -> bytes:
    """Return a page as PDF 1.4, which states its size in points and asks viewers not to scale."""
    drawn = [f"{POINTS_PER_MM:.8f} 0 0 {POINTS_PER_MM:.8f} 0 0 cm"]
    drawn += [
        f"{b.x:.4f} {page.height - b.y - b.height:.4f} {b.width:.4f} {b.height:.4f} re f"
        for b in page.boxes
    ]
    for line in page.lines:
        text = line.text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        drawn.append(f"BT /F1 3.2 Tf {line.x:.2f} {page.height - line.y:.2f} Td ({text}) Tj ET")
    stream = "\n".join(drawn).encode("ascii")
    size = f"{page.width * POINTS_PER_MM:.3f} {page.height * POINTS_PER_MM:.3f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    content, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        offsets.append(len(content))
        content += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    return content + (
        b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\n"
        b"startxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table, len(objects) + 1, len(content))
    )
