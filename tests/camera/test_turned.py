"""Detectors that look at turned images, and answer in pixels of the unturned ones."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.camera.orientation import Orientation, turned
from e3pose.detectors.drawn import Drawn, draw
from e3pose.detectors.focus import Focusing, InBoxes, Part, detect_expected
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

WIDTH, HEIGHT = 7, 5
CLOCKWISE = {
    90: cv2.ROTATE_90_CLOCKWISE,
    180: cv2.ROTATE_180,
    270: cv2.ROTATE_90_COUNTERCLOCKWISE,
}
ANGLES = [0, *CLOCKWISE]


def turn(image: Any, degrees: int) -> Any:
    return cv2.rotate(image, CLOCKWISE[degrees]) if degrees else image


def numbered() -> NDArray[np.uint8]:
    """Return an image of which every pixel has another level."""
    levels = np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH, 1)
    return np.repeat(levels, 3, axis=2)


class Levels:
    """Finds joint `j` at the centre of the pixel whose level is `j`; keeps what it was shown."""

    skeleton = COCO17

    def __init__(self) -> None:
        self.shown: list[Any] = []

    def detect(self, image: Any) -> Poses2D:
        self.shown.append(image)
        rows_columns = [np.argwhere(image[:, :, 0] == j)[0] for j in range(17)]
        return Poses2D(np.array(rows_columns, dtype=float)[None, :, ::-1], np.full((1, 17), 0.5))


class Parts(Levels):
    """Keeps what it was asked, of parts."""

    person_px, long_side, multiple = 100.0, 256, 32

    def detect_part(self, image: Any, part: Part, expected: ExpectedView | None = None) -> Poses2D:
        self.asked = part.cut(image), part.long_side, expected
        return self.detect(image)


class Boxes(Levels):
    """Keeps what it was asked, of boxes."""

    def detect_in_boxes(self, image: Any, boxes: NDArray[np.float64]) -> Poses2D:
        self.asked = boxes
        return self.detect(image)


@each_case("degrees", ANGLES)
def test_detector_sees_the_turned_image_and_answers_in_pixels_of_the_other(degrees: int) -> None:
    image, levels = numbered(), Levels()
    found = turned(levels, degrees).detect(image)
    np.testing.assert_array_equal(levels.shown[0], turn(image, degrees))
    known_px = [(j % WIDTH, j // WIDTH) for j in range(17)]  # pixel centres are whole numbers
    np.testing.assert_array_equal(found.keypoints_px, [known_px])
    np.testing.assert_array_equal(found.scores, np.full((1, 17), 0.5))
    looks = turned(Levels(), degrees)  # without feedback it stays without
    assert not isinstance(looks, Focusing | InBoxes) and turned(looks, 0) is looks


@each_case("degrees", ANGLES)
def test_points_go_there_and_back_with_missing_ones_missing(degrees: int) -> None:
    orientation = Orientation.from_degrees(degrees)
    points_px = np.array([[-0.5, -0.5], [6.5, 4.5], [1.25, 3.0], [np.nan, np.nan]])
    there = orientation.points(points_px, WIDTH, HEIGHT)
    corner = {0: (-0.5, -0.5), 90: (4.5, -0.5), 180: (6.5, 4.5), 270: (-0.5, 6.5)}
    np.testing.assert_array_equal(there[0], corner[degrees])
    np.testing.assert_array_equal(orientation.points_back(there, WIDTH, HEIGHT), points_px)


@each_case("degrees", ANGLES)
def test_part_and_expected_people_are_turned_too(degrees: int) -> None:
    image, parts, part = numbered(), Parts(), Part(1, 2, 4, 3, 64)
    known_px = np.array([[(j % WIDTH, j // WIDTH) for j in range(17)]], dtype=float)
    expected = ExpectedView(known_px, np.array([3.0]))
    looks = turned(parts, degrees)
    assert isinstance(looks, Focusing) and not isinstance(looks, InBoxes)
    assert (looks.person_px, looks.long_side, looks.multiple) == (100.0, 256, 32)
    found = looks.detect_part(image, part, expected)
    cut, long_side, expected_view = parts.asked
    np.testing.assert_array_equal(cut, turn(np.ascontiguousarray(part.cut(image)), degrees))
    assert long_side == 64 and expected_view is not None
    columns, rows = expected_view.keypoints_px[0].astype(int).T
    assert parts.shown[0][rows, columns, 0].tolist() == list(range(17))
    np.testing.assert_array_equal(found.keypoints_px, expected.keypoints_px)


@each_case("degrees", ANGLES)
def test_boxes_are_turned_too(degrees: int) -> None:
    image, boxes = numbered(), Boxes()
    looks = turned(boxes, degrees)
    assert isinstance(looks, InBoxes) and not isinstance(looks, Focusing)
    found = looks.detect_in_boxes(image, np.array([[1.0, 2.0, 5.0, 4.0], [0.0, 0.0, 7.0, 5.0]]))
    left, top, right, bottom = boxes.asked[0].astype(int)
    np.testing.assert_array_equal(
        boxes.shown[0][top:bottom, left:right],
        turn(np.ascontiguousarray(image[2:4, 1:5]), degrees),
    )
    size = (5, 7) if degrees in (90, 270) else (7, 5)
    np.testing.assert_array_equal(boxes.asked[1], [0, 0, *size])
    np.testing.assert_array_equal(found.keypoints_px[0, 16], [16 % WIDTH, 16 // WIDTH])


@each_case("degrees", ANGLES)
def test_expected_people_are_found_in_turned_images(degrees: int) -> None:
    along = np.linspace(0, 1, 17)
    here, there = (np.stack([x + along * 60, 60 + along * 260], axis=-1) for x in (80, 400))
    image = draw(np.full((400, 560, 3), 24, dtype=np.uint8), [here, there])
    expected = ExpectedView(here[None], np.array([5.0]))
    looks = turned(Drawn(), degrees)
    assert len(looks.detect(image)) == 2
    (found,) = detect_expected(looks, image, expected).keypoints_px
    np.testing.assert_allclose(found, here, atol=1.0)
