"""Calibration boards: ChArUco and chessboards, their corners, and a page to print."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError

SIDE = r"(\d{1,4}(?:\.\d{1,3})?)mm"
NAME = re.compile(rf"(charuco|chessboard)-(\d{{1,2}})x(\d{{1,2}})-{SIDE}((?:-[a-z0-9_.]+)*)")
# ArUco dictionaries by name, and how many markers each has.
DICTIONARIES = {
    **{f"{n}x{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "aruco_original": 1024, "aruco_mip_36h12": 250, "apriltag_16h5": 30, "apriltag_25h9": 35,
    "apriltag_36h10": 2320, "apriltag_36h11": 587,
}  # fmt: skip
SIDES = (3, 24)  # squares along a side, from and to
SQUARE_MM = (5.0, 1000.0)
MARKER_SHARE = 0.75  # of a square's side: 6 of 8 cells of the drawing
MARKER_SHARES = (0.3, 0.95)  # of boards that others print
CELLS = 8  # of the drawing along a square's side
ENLARGED_PX = 2000  # pictures up to this size are searched again at twice the size
SEARCH_PX = 1280  # a larger picture is searched at this size, then refined at its own
MIN_CORNERS = 6  # fewer say too little of where the board is


@dataclass(frozen=True, slots=True)
class Board:
    """A printed board.

    Attributes:
        kind: `charuco` or `chessboard`.
        columns: squares from left to right.
        rows: squares from top to bottom.
        square_m: side of a square in metres.
        marker_share: side of a marker as a share of that.
        dictionary: of the markers, in `DICTIONARIES`; empty for what e3pose prints.
        legacy: whether the pattern is that of OpenCV before 4.6, whose first square is white on
            boards with an even number of rows.
        two_sided: whether the back has the mirror image, each corner behind its own.
    """

    kind: str
    columns: int
    rows: int
    square_m: float
    marker_share: float = MARKER_SHARE
    dictionary: str = ""
    legacy: bool = False
    two_sided: bool = False

    def __post_init__(self) -> None:
        for side, number in (("columns", self.columns), ("rows", self.rows)):
            if not SIDES[0] <= number <= SIDES[1]:
                raise InputError(
                    f"board: {side}: found {number}, expected {SIDES[0]} to {SIDES[1]} squares"
                )
        if not SQUARE_MM[0] <= 1000 * self.square_m <= SQUARE_MM[1]:
            raise InputError(
                f"board: square: found {1000 * self.square_m:g} mm, expected {SQUARE_MM[0]:g} to "
                f"{SQUARE_MM[1]:g} mm"
            )
        if self.kind == "chessboard":
            if self.dictionary or self.legacy or self.marker_share != MARKER_SHARE:
                raise InputError("board: chessboard: found markers, expected charuco with them")
            if self.two_sided:
                raise InputError(
                    "board: chessboard: found two-sided, expected charuco: a chessboard looks the "
                    "same from behind"
                )
            return
        low, high = MARKER_SHARES
        if not low <= self.marker_share <= high:
            raise InputError(
                f"board: marker: found {1000 * self.marker_share * self.square_m:g} mm, expected "
                f"{low:g} to {high:g} of a square of {1000 * self.square_m:g} mm"
            )
        if self.dictionary and self.dictionary not in DICTIONARIES:
            raise InputError(
                f"board: dictionary: found {self.dictionary[:40]!r}, expected one of "
                + ", ".join(DICTIONARIES)
            )
        needed = self.columns * self.rows // 2
        if self.dictionary and needed > DICTIONARIES[self.dictionary]:
            raise InputError(
                f"board: dictionary: {self.dictionary} has {DICTIONARIES[self.dictionary]} "
                f"markers, expected the {needed} of {self.columns}x{self.rows} squares"
            )

    @classmethod
    def parse(cls, name: str) -> Board:
        """Read a name: columns x rows of squares, side of a square, and what differs from e3pose's.

        Such as `charuco-5x7-37mm` or `charuco-8x11-40mm-5x5_250-30mm-legacy-twosided`: dictionary,
        side of a marker, pattern of OpenCV before 4.6, mirror image on the back.

        Raises:
            InputError: for any other name.
        """
        match = NAME.fullmatch(name.strip().lower())
        if match is None:
            raise InputError(
                f"board: found {name[:60]!r}, expected a name as it is printed on the board, such "
                "as charuco-5x7-37mm, charuco-8x11-40mm-5x5_250-30mm or chessboard-6x9-30mm "
                "(squares, not inner corners)"
            )
        square_m, share, dictionary, flags = float(match[4]) / 1000, MARKER_SHARE, "", set()
        for word in match[5].split("-")[1:]:
            side = re.fullmatch(SIDE, word)
            if side is not None:
                share = float(side[1]) / 1000 / square_m if square_m else 0.0
            elif word in ("legacy", "twosided"):
                flags.add(word)
            else:
                dictionary = word
        return cls(
            match[1], int(match[2]), int(match[3]), square_m, share, dictionary,
            "legacy" in flags, "twosided" in flags,
        )  # fmt: skip

    @property
    def name(self) -> str:
        """The text that `parse` reads."""
        words = [self.kind, f"{self.columns}x{self.rows}", f"{1000 * self.square_m:.6g}mm"]
        words += [self.dictionary] if self.dictionary else []
        if self.marker_share != MARKER_SHARE:
            words.append(f"{1000 * self.marker_share * self.square_m:.6g}mm")
        words += ["legacy"] * self.legacy + ["twosided"] * self.two_sided
        return "-".join(words)

    def check_oriented(self) -> None:
        """Raise `InputError` if the board looks the same upside down."""
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise InputError(
                f"board: chessboard of {self.columns}x{self.rows} squares: expected one odd and "
                "one even side, as other boards look the same upside down to another camera; it "
                "serves for lenses alone"
            )

    @property
    def corners_m(self) -> Floats:
        """`(num_corners, 3)` inner corners: x to the right, y down the page, z into the page."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        grid = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
        return np.asarray(grid * self.square_m, dtype=np.float64)

    def cells(self) -> NDArray[np.bool_]:
        """`(8 * rows, 8 * columns)` the drawing, eight cells to a square; True is black."""
        if self.kind == "charuco":
            size = (self.columns * CELLS, self.rows * CELLS)
            picture = _charuco(self).generateImage(size, marginSize=0, borderBits=1)
            return np.asarray(picture < 128)
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.asarray(((x + y) % 2 == 0).repeat(CELLS, axis=0).repeat(CELLS, axis=1))


def make_finder(board: Board) -> Callable[[NDArray[np.uint8]], Floats]:
    """Return a finder of the board in a grey `(height, width)` picture.

    It returns `(num_corners, 2)` pixels in the order of `corners_m`, NaN where a corner was not
    found; all NaN without the board, or with fewer than `MIN_CORNERS` corners that form no line.
    """
    find = _charuco_finder(board) if board.kind == "charuco" else _chessboard_finder(board)
    return _either_side(find) if board.two_sided else find


def _either_side(
    find: Callable[[NDArray[np.uint8]], Floats],
) -> Callable[[NDArray[np.uint8]], Floats]:
    """Return a finder of a board that has its mirror image on the back."""

    def find_either(grey: NDArray[np.uint8]) -> Floats:
        front = find(grey)
        if np.isfinite(front).any():
            return front
        back = find(np.ascontiguousarray(grey[:, ::-1]))
        back[:, 0] = grey.shape[1] - 1 - back[:, 0]
        return back

    return find_either


def _charuco(board: Board) -> Any:
    import cv2

    cells = board.columns * board.rows
    usual = "4x4_50" if cells <= 100 else "4x4_250" if cells <= 500 else "4x4_1000"
    name = board.dictionary or usual
    # OpenCV's names have capitals but for the h of AprilTags.
    constant = re.sub(r"(?<=\d)H(?=\d)", "h", f"DICT_{name.upper()}")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, constant))
    size = (board.columns, board.rows)
    made = cv2.aruco.CharucoBoard(size, 1.0, board.marker_share, dictionary)
    made.setLegacyPattern(board.legacy)
    return made


def _charuco_finder(board: Board) -> Callable[[NDArray[np.uint8]], Floats]:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    # Markers are read; the corners between them are refined by the detector of the board itself.
    parameters.minMarkerPerimeterRate = 0.01
    detector = cv2.aruco.CharucoDetector(_charuco(board), detectorParams=parameters)
    number = (board.columns - 1) * (board.rows - 1)

    def find(grey: NDArray[np.uint8]) -> Floats:
        # Far boards, whose markers have two pixels a cell, are read in an enlarged picture.
        for factor in (1, 2) if max(grey.shape) <= ENLARGED_PX else (1,):
            large = grey
            if factor > 1:
                large = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            found = np.full((number, 2), np.nan)
            corners, ids, _, _ = detector.detectBoard(large)
            if ids is not None and len(ids) >= MIN_CORNERS:
                index = np.asarray(ids).reshape(-1)
                pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
                found[index] = (pixels + 0.5) / factor - 0.5
            if _spread(board, found):
                return found
        return np.full((number, 2), np.nan)

    return find


def _chessboard_finder(board: Board) -> Callable[[NDArray[np.uint8]], Floats]:
    import cv2

    size = (board.columns - 1, board.rows - 1)
    number = size[0] * size[1]
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)

    def find(grey: NDArray[np.uint8]) -> Floats:
        share = min(1.0, SEARCH_PX / max(grey.shape))
        small = grey if share == 1 else cv2.resize(grey, None, fx=share, fy=share, interpolation=3)
        done, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
        if not done or len(corners) != number:
            return np.full((number, 2), np.nan)
        pixels = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / share - 0.5
        if share < 1:
            apart = np.linalg.norm(np.diff(pixels.reshape(size[1], size[0], 2), axis=1), axis=-1)
            half = int(np.clip(apart.min() / 4, 2, 15))
            refined = cv2.cornerSubPix(
                grey, pixels.astype(np.float32), (half, half), (-1, -1), criteria
            )
            pixels = np.asarray(refined, dtype=np.float64)
        # The finder may begin at either end; the square beside the first corner tells which.
        return np.array(pixels if _begins_black(grey, pixels, size[0]) else pixels[::-1])

    return find


def _begins_black(grey: NDArray[np.uint8], pixels: Floats, columns: int) -> bool:
    """Return whether the first corner is the one at the black corner square of the page."""

    def brightness(corner: int, right: int, below: int) -> float:
        outward = pixels[corner] - (pixels[right] - pixels[corner]) / 2
        outward -= (pixels[below] - pixels[corner]) / 2
        x, y = np.clip(np.round(outward), 0, np.array(grey.shape[::-1]) - 1).astype(int)
        return float(grey[y, x])

    last = len(pixels) - 1
    return brightness(0, 1, columns) <= brightness(last, last - 1, last - columns)


def _spread(board: Board, corners_px: Floats) -> bool:
    """Return whether there are enough corners, in two directions."""
    found = board.corners_m[np.isfinite(corners_px[:, 0])]
    if len(found) < MIN_CORNERS:
        return False
    centred = found[:, :2] - found[:, :2].mean(axis=0)
    return bool(np.linalg.svd(centred, compute_uv=False)[1] > 0.5 * board.square_m)


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
    # The name with a place for the side that is measured.
    side = f"{1000 * board.square_m:.6g}mm"
    with_side = board.name.replace(side, "<its side>mm", 1)
    lines = (
        Line(bar, foot + 5.5, f"{board.name}: print at 100 % (no fit to page). This bar is"),
        Line(bar, foot + 9.5, f"{BAR_MM:g} mm from end to end; if not, measure a square and pass"),
        Line(bar, foot + 13.5, f"--board {with_side}"),
    )
    return Page(width, height, tuple(boxes), lines)


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
