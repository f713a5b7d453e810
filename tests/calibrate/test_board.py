"""Boards: what is printed, and that it is found where it is."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibrate.board_pictures import facing, render
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.calibrate.board import Board, as_pdf, as_svg, draw_page, largest_square_mm, make_finder
from e3pose.calibrate.board_views import find_board
from e3pose.model.camera import Camera

pytestmark = pytest.mark.slow

K = np.array([[700.0, 0, 330], [0, 705, 236], [0, 0, 1]])
CAMERA = Camera("cam1", (640, 480), K, np.eye(4), np.array([-0.2, 0.06, 0.001, -0.001]))


@each_case("name", ["charuco-5x7-36mm", "charuco-6x8-20mm", "chessboard-5x8-60.5mm"])
def test_board_is_what_its_name_says(name: str) -> None:
    board = Board.parse(name)
    assert board.name == name
    assert board.cells().shape == (8 * board.rows, 8 * board.columns)
    assert len(board.corners_m) == (board.rows - 1) * (board.columns - 1)


@each_case(
    "name, roll",
    [
        ("charuco-5x7-36mm", 0.0), ("charuco-5x7-36mm", np.pi), ("charuco-6x8-20mm", 0.4),
        ("chessboard-5x8-60mm", 0.0), ("chessboard-5x8-60mm", np.pi),
    ],
)  # fmt: skip
def test_corners_are_found_where_they_are(name: str, roll: float) -> None:
    board = Board.parse(name)
    middle = np.array([0.0, 0.0, 12.5 * board.square_m * board.rows / 7])
    placed = facing(CAMERA, board, middle, (0.3, -0.4), roll)
    found = make_finder(board)(render(CAMERA, board, placed))
    truth = CAMERA.project(board.corners_m @ placed[:3, :3].T + placed[:3, 3])
    assert np.isfinite(found).all()
    assert np.linalg.norm(found - truth, axis=1).max() < 0.4
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.12


@each_case(
    "name",
    [
        "charuco-8x11-25mm-5x5_250-18mm", "charuco-5x7-36mm-apriltag_36h11-30mm",
        "charuco-6x8-30mm-6x6_100-15mm-legacy", "charuco-5x7-36mm-aruco_original",
    ],
)  # fmt: skip
def test_boards_of_others_are_found(name: str) -> None:
    board = Board.parse(name)
    assert board.name == name
    picture, scale = _drawn(board)
    found = make_finder(board)(picture)
    assert np.isfinite(found).all()
    truth = board.corners_m[:, :2] / board.square_m * scale + 60 - 0.5
    assert np.abs(found - truth).max() < 0.5
    usual = Board(board.kind, board.columns, board.rows, board.square_m)
    assert np.isnan(make_finder(usual)(picture)).all()


def _drawn(board: Board) -> tuple[NDArray[np.uint8], float]:
    """Return a picture of a board as OpenCV draws it, and its pixels a square."""
    names = {"apriltag_36h11": cv2.aruco.DICT_APRILTAG_36h11}
    number = names.get(board.dictionary) or getattr(
        cv2.aruco, f"DICT_{board.dictionary.upper()}"
    )  # fmt: skip
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), 1.0, board.marker_share,
        cv2.aruco.getPredefinedDictionary(number),
    )  # fmt: skip
    made.setLegacyPattern(board.legacy)
    scale = 80
    drawn = made.generateImage((board.columns * scale, board.rows * scale))
    return np.pad(drawn, 60, constant_values=255), scale


def test_back_of_a_two_sided_board_has_the_same_corners() -> None:
    board = Board.parse("charuco-5x7-36mm-twosided")
    front = facing(CAMERA, board, np.array([0.0, 0.0, 0.45]), (0.3, -0.4), 0.2)
    picture = render(CAMERA, board, front)
    mirrored = np.ascontiguousarray(picture[:, ::-1])  # a board that is seen from behind
    assert np.isnan(make_finder(Board.parse("charuco-5x7-36mm"))(mirrored)).all()
    found = make_finder(board)(mirrored)
    assert found == pytest.approx(
        make_finder(board)(picture) * [-1, 1] + [mirrored.shape[1] - 1, 0], abs=1e-9
    )


def test_chessboard_that_looks_the_same_upside_down_serves_for_lenses_alone() -> None:
    board = Board.parse("chessboard-6x8-40mm")
    placed = facing(CAMERA, board, np.array([0.0, 0.0, 0.6]), (0.3, -0.4))
    found = make_finder(board)(render(CAMERA, board, placed))
    truth = CAMERA.project(board.corners_m @ placed[:3, :3].T + placed[:3, 3])
    off = min(np.abs(found - truth).max(), np.abs(found[::-1] - truth).max())
    assert off < 0.4
    with pytest.raises(InputError, match="expected one odd and one even side"):
        board.check_oriented()
    with pytest.raises(InputError, match="expected one odd and one even side"):
        draw_page(board, "a3")


def test_part_of_a_charuco_board_is_enough_and_nothing_is_nothing() -> None:
    board = Board.parse("charuco-5x7-36mm")
    placed = facing(CAMERA, board, np.array([0.1, 0.0, 0.3]), (0.2, 0.1))
    found = make_finder(board)(render(CAMERA, board, placed))
    assert 6 <= np.isfinite(found[:, 0]).sum() < len(found)
    assert np.isnan(make_finder(board)(np.full((480, 640), 90, dtype=np.uint8))).all()


def test_page_is_at_true_scale_in_both_formats() -> None:
    board = Board.parse("charuco-5x7-36mm")
    assert largest_square_mm("a4", 5, 7) == 36
    with pytest.raises(InputError, match=r"squares of 60 mm take 300 x 420 mm"):
        draw_page(Board.parse("charuco-5x7-60mm"), "a4")
    page = draw_page(board, "a4")
    assert 'width="210mm" height="297mm" viewBox="0 0 210 297"' in as_svg(page)
    pdf = as_pdf(page)
    assert b"/MediaBox [0 0 595.276 841.890]" in pdf
    assert b"/PrintScaling /None" in pdf
    start = int(re.findall(rb"startxref\n(\d+)", pdf)[0])
    assert pdf[start : start + 4] == b"xref"
    black = np.zeros((2970, 2100), dtype=bool)  # ten dots a millimetre
    for box in page.boxes:
        rows = slice(round(10 * box.y), round(10 * (box.y + box.height)))
        black[rows, round(10 * box.x) : round(10 * (box.x + box.width))] = True
    grey = np.where(black, 0, 255).astype(np.uint8)
    corners = make_finder(board)(grey).reshape(6, 4, 2)
    assert np.linalg.norm(corners[:, 1:] - corners[:, :-1], axis=-1) == pytest.approx(360, abs=0.3)


def test_back_of_a_page_is_its_mirror_image() -> None:
    board = Board.parse("charuco-5x7-36mm-twosided")
    front, back = (draw_page(board, "a4", back=back) for back in (False, True))
    assert sorted((round(b.x, 3), round(b.y, 3)) for b in front.boxes) == sorted(
        (round(210 - b.x - b.width, 3), round(b.y, 3)) for b in back.boxes
    )
    assert "charuco-5x7-<its side>mm-twosided" in front.lines[-1].text


@each_case(
    ("name", "message"),
    [
        ("charuco", "expected a name as it is printed on the board"),
        ("charuco-2x7-36mm", "columns: found 2"),
        ("charuco-5x7-3mm", "square: found 3 mm"),
        ("charuco-5x7-36mm-5x5_40", "dictionary: found '5x5_40', expected one of 4x4_50"),
        ("charuco-12x9-36mm-4x4_50", "4x4_50 has 50 markers, expected the 54"),
        ("charuco-5x7-36mm-36mm", "marker: found 36 mm, expected 0.3 to 0.95 of a square"),
        ("chessboard-5x8-30mm-20mm", "chessboard: found markers"),
        ("chessboard-5x8-30mm-twosided", "a chessboard looks the same from behind"),
    ],
)
def test_wrong_name_is_reported(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Board.parse(name)


def test_folder_of_pictures_is_searched_in_order(tmp_path: Path) -> None:
    board = Board.parse("charuco-5x7-36mm")
    placed = facing(CAMERA, board, np.array([0.0, 0.0, 0.5]), (0.3, 0.2))
    picture = render(CAMERA, board, placed)
    for number, image in enumerate([picture, np.full_like(picture, 90), picture]):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    views = find_board("cam1", tmp_path, board)
    assert views.times_s.tolist() == [0.0, 2.0]
    assert (views.searched, views.image_size) == (3, (640, 480))
    cv2.imwrite(str(tmp_path / "3.png"), np.zeros((10, 10), dtype=np.uint8))
    with pytest.raises(InputError, match="found 10x10 after 640x480"):
        find_board("cam1", tmp_path, board)
    with pytest.raises(InputError, match="file not found"):
        find_board("cam1", tmp_path / "no.png", board)
