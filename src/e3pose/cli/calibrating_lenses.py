"""`e3pose calibrate board` and `intrinsics`: a board to print, and lenses from films of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import Progress

from e3pose.base.atomic import check_output, write_file
from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within, plural, shell
from e3pose.calibrate.board import Board, as_pdf, as_svg, draw_page, largest_square_mm
from e3pose.calibrate.board_views import find_board
from e3pose.cli.options import Flag, Whole
from e3pose.cli.output import JsonFile, is_stdout, write_json
from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.recording.pairing import name_videos

DEFAULT_BOARD = "charuco-5x7-36mm"  # what `calibrate board` makes for A4


def board(
    name: Path = Path("board"),
    *,
    paper: Literal["a4", "a3", "letter"] = "a4",
    kind: Literal["charuco", "chessboard"] = "charuco",
    columns: Whole = 5,
    rows: Whole | None = None,
    square: float | None = None,
    two_sided: Flag = False,
) -> None:
    """Write a calibration board to print, as PDF and as SVG at true scale.

    Example: `e3pose calibrate board --paper a3`

    Print it at 100 % ("actual size"), check the bar with a ruler, and glue the page to something
    flat and stiff. Distant cameras need large squares: a 1080p camera with 70 degrees field of view
    reads 36 mm (A4) up to about 3 m, 54 mm (A3) up to about 5 m.

    Parameters
    ----------
    name
        Files to write, without the suffix: NAME.pdf and NAME.svg.
    paper
        Paper size.
    kind
        Board type. A ChArUco board may be partly hidden or outside the image, a chessboard may not.
    columns
        Squares across.
    rows
        Squares down. Default: 7; 8 for a chessboard.
    square
        Side of a square in millimetres. Default: as large as fits on the paper.
    two_sided
        Also write the mirror image, NAME-back.pdf and NAME-back.svg, for the back: cameras that
        face each other then see the same board. Glue both so that their corners meet.
    """
    if rows is None:
        rows = 7 if kind == "charuco" else 8
    side = square if square is not None else largest_square_mm(paper, max(columns, 1), max(rows, 1))
    drawn = Board(kind, columns, rows, side / 1000, two_sided=two_sided)
    pages = {name: draw_page(drawn, paper)}
    if two_sided:
        pages[name.with_name(f"{name.name}-back")] = draw_page(drawn, paper, back=True)
    files = {
        stem.with_name(f"{stem.name}{suffix}"): content
        for stem, page in pages.items()
        for suffix, content in ((".pdf", as_pdf(page)), (".svg", as_svg(page).encode()))
    }
    for path in files:
        check_output(path)
    for path, content in files.items():
        write_file(path, content)
    print(f"{', '.join(map(str, files))}: {drawn.name} on {paper.upper()}")
    print("Print at 100 %, measure the bar (100 mm), glue the page to something flat and stiff.")
    wanted = "" if drawn.name == DEFAULT_BOARD else f" --board {drawn.name}"
    print(
        f"Then film it with each camera: e3pose calibrate intrinsics cam*.mp4 lenses.toml{wanted}"
    )


def intrinsics(
    *paths: str,
    board: str = DEFAULT_BOARD,
    model: Literal["auto", "pinhole", "pinhole-k3", "fisheye"] = "auto",
    frames: Whole = 300,
    picture: Path | None = None,
    json_output: JsonFile = None,
) -> None:
    """Calibrate the lens of each camera from videos or images of a board.

    Example: `e3pose calibrate intrinsics cam1.mp4 cam2.mp4 lenses.toml --picture coverage.png`

    Lock focus and zoom first, and do not change them afterwards. Film the board for half a minute
    with each camera: so near that it fills a third of the image, moved slowly through all parts of
    the image including its corners, and tilted in all directions.

    Parameters
    ----------
    paths
        VIDEO... DEST: videos or folders of images, then the calibration file (.toml) to write.
        CAMERA=PATH names the camera. Default: the file name.
    board
        Board name, as printed on it: type, squares across x down, measured side of a square. Of
        other programs' boards also dictionary and side of a marker, `legacy`, `twosided`:
        charuco-8x11-40mm-5x5_250-30mm-legacy.
    model
        Lens model: `pinhole` (k1 k2 p1 p2), `pinhole-k3` or `fisheye`. `auto` takes the one with
        the least error on views that were not used for the fit.
    frames
        Number of frames to search in each video, evenly spread.
    picture
        Draw the board corners and their errors here (.png or .svg).
    json_output
        Write the result here as JSON; - is standard output, which then contains nothing else.
    """
    from e3pose.calibrate.intrinsics import (
        MODELS,
        as_lines,
        as_values,
        draw_coverage,
        fit_intrinsics,
        make_report,
    )

    if len(paths) < 2:
        given = plural(len(paths), "path")
        raise InputError(f"VIDEO... DEST: found {given}, expected videos, then the file to write")
    *films, last = paths
    dest = toml_path(last)
    check_within("--frames", frames, 5, 100_000)
    if picture is not None:
        check_picture("--picture", picture)
        check_output(picture)
    filmed = Board.parse(board)
    named = name_videos(films)
    reports = []
    with camera_bar() as bar:
        for camera_id, path in named.items():
            views = find_board(camera_id, path, filmed, None, frames, bar(camera_id))
            fit = fit_intrinsics(
                camera_id, views.image_size, filmed.corners_m, views.corners_px, views.sharpness,
                MODELS if model == "auto" else (model,),
            )  # fmt: skip
            reports.append(make_report(views, fit, filmed.corners_m))
    save_rig(Rig(tuple(report.fit.camera for report in reports), placed=False), dest)
    if picture is not None:
        draw_coverage(picture, reports)
    write_json(json_output, {"cameras": [as_values(report) for report in reports]})
    if is_stdout(json_output):
        return
    for report in reports:
        print("\n".join(as_lines(report)))
    print(f"{dest}: lenses of {', '.join(named)}; where they stand is not known yet")
    print(f"Then: e3pose calibrate extrinsics VIDEO... rig.toml --intrinsics {shell(dest)}")


def toml_path(word: str) -> Path:
    """Return the calibration file to write; raise `InputError` if it cannot be one."""
    path = Path(word)
    if path.suffix.lower() != ".toml":
        raise InputError(f"DEST: found {word[-80:]!r}, expected a calibration file to write, .toml")
    check_output(path)
    return path


def check_picture(option: str, path: Path) -> None:
    """Raise `InputError` unless a picture can be written at `path`."""
    if path.suffix.lower() not in (".png", ".svg"):
        raise InputError(f"{option}: found {path.name!r}, expected a name ending in .png or .svg")


@contextmanager
def camera_bar() -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    """Yield what makes a bar for one camera, of frames looked at; silent in a pipe."""
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:

        def begin(camera_id: str) -> Callable[[int, int], None]:
            task = bar.add_task(f"{camera_id}: looking for the board", total=None)
            return lambda done, total: bar.update(task, completed=done, total=total)

        yield begin
