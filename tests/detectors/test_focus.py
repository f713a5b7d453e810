"""Looks at the part of an image in which people are expected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from e3pose.base.errors import InputError
from e3pose.detectors import make_detector
from e3pose.detectors.drawn import draw
from e3pose.detectors.focus import (
    MARGIN,
    Focusing,
    InBoxes,
    Part,
    check_feedback,
    detect_expected,
    look_at,
)
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

SIZE = (1280, 720)


class Network:
    """Finds people of 200 pixels best; keeps what it was asked."""

    skeleton = COCO17
    person_px, long_side, multiple = 200.0, 512, 32

    def __init__(self) -> None:
        self.parts: list[Part | None] = []

    def detect(self, image: Any) -> Poses2D:
        self.parts.append(None)
        return Poses2D.empty(17)

    def detect_part(self, image: Any, part: Part, expected: ExpectedView | None = None) -> Poses2D:
        self.parts.append(part)
        return Poses2D.empty(17)


def person(left: float, top: float, height: float) -> Any:
    """Return `(17, 2)` keypoints of a person a third as wide as high."""
    along = np.linspace(0, 1, 17)
    return np.stack([left + along * height / 3, top + along * height], axis=-1)


def expected(*people: Any, reach: float = 10.0) -> ExpectedView:
    return ExpectedView(np.array(people).reshape(-1, 17, 2), np.full(len(people), reach))


def part_of(view: ExpectedView) -> Part | None:
    """Return where to look for everybody, for a network of one input size."""
    look = look_at(view, SIZE, Network())
    assert look is None or isinstance(look, Part)
    return look


def whole_pixels() -> float:
    return Network.long_side**2 * SIZE[1] / SIZE[0]


def test_part_holds_everybody_with_a_margin() -> None:
    view = expected(person(300, 200, 300), person(700, 250, 240))
    part = part_of(view)
    assert part is not None
    margin = MARGIN * 300 + 10
    assert part.left == pytest.approx(300 - margin, abs=1)
    assert part.top == pytest.approx(200 - margin, abs=1)
    assert part.left + part.width == pytest.approx(780 + MARGIN * 240 + 10, abs=1)


def test_input_shows_people_at_the_best_size() -> None:
    part = part_of(expected(person(300, 200, 400)))
    assert part is not None
    scale = part.long_side / max(part.size)
    assert 400 * scale == pytest.approx(200, rel=0.1)
    both = part_of(expected(person(500, 100, 350), person(650, 100, 450)))
    assert both is not None
    mean_px = (350 * 450) ** 0.5 * both.long_side / max(both.size)
    assert mean_px == pytest.approx(200, rel=0.1)
    far = part_of(expected(person(300, 200, 150)))
    assert far is not None and 150 * far.long_side / max(far.size) == pytest.approx(200, rel=0.2)


def test_nobody_expected_or_everybody_outside_is_a_whole_look() -> None:
    assert part_of(expected()) is None
    assert part_of(expected(person(2000, 200, 300))) is None
    unknown = ExpectedView(np.full((1, 17, 2), np.nan), np.array([5.0]))
    assert part_of(unknown) is None


@given(
    st.lists(
        st.tuples(st.floats(-500, 1500), st.floats(-500, 1000), st.floats(1, 2000)),
        min_size=1,
        max_size=4,
    ),
    st.floats(0, 500),
)
@example(people=[(331.0, 329.0, 2.0)], reach=330.0)
def test_part_is_inside_the_image_and_never_costs_more_than_a_whole_look(
    people: list[tuple[float, float, float]], reach: float
) -> None:
    part = part_of(expected(*(person(*each) for each in people), reach=reach))
    if part is None:
        return
    assert part.left >= 0 and part.left + part.width <= SIZE[0] and part.width > 0
    assert part.top >= 0 and part.top + part.height <= SIZE[1] and part.height > 0
    assert part.long_side % Network.multiple == 0 and part.long_side > 0
    area = part.long_side**2 * min(part.size) / max(part.size)
    before = max(part.long_side - Network.multiple, 1)  # it is rounded up from more than this
    assert area <= whole_pixels() * (part.long_side / before) ** 2 * (1 + 1e-9)


def test_detector_that_cannot_focus_looks_at_the_whole_image() -> None:
    class Plain:
        def detect(self, image: Any) -> Poses2D:
            return Poses2D.empty(17)

    image = np.zeros((720, 1280, 3), dtype=np.uint8)
    assert not isinstance(Plain(), Focusing)
    assert len(detect_expected(Plain(), image, expected(person(300, 200, 300)))) == 0
    network = Network()
    detect_expected(network, image, None)
    detect_expected(network, image, expected(person(300, 200, 300)))
    assert network.parts[0] is None and network.parts[1] is not None


def test_detector_of_one_person_gets_a_box_of_each_who_is_expected_in_the_image() -> None:
    class Boxed:
        def __init__(self) -> None:
            self.asked: list[Any] = []

        def detect(self, image: Any) -> Poses2D:
            return Poses2D.empty(17)

        def detect_in_boxes(self, image: Any, boxes: Any) -> Poses2D:
            self.asked += list(boxes)
            return Poses2D.empty(17)

    image, boxed = np.zeros((720, 1280, 3), dtype=np.uint8), Boxed()
    assert isinstance(boxed, InBoxes)
    detect_expected(boxed, image, expected(person(2000, 200, 300)))
    assert not boxed.asked  # outside the image: full-frame detection
    detect_expected(boxed, image, expected(person(300, 200, 300), person(-20, 100, 200)))
    margin = MARGIN * 300 + 10
    left, right = 300 - margin, 400 + margin
    assert boxed.asked[0] == pytest.approx([left, 200 - margin, right, 500 + margin])
    assert len(boxed.asked) == 2 and boxed.asked[1][0] == 0  # cut at the image


def test_detector_without_a_use_for_feedback_is_refused_by_name() -> None:
    check_feedback(Network(), "network")
    with pytest.raises(InputError, match="feedback: found with mine:Own, which detects in whol"):
        check_feedback(object(), "mine:Own")


def test_people_in_a_part_are_found_where_they_are_in_the_image() -> None:
    grey = np.full((720, 1280, 3), 24, dtype=np.uint8)
    here, there = person(300, 150, 400), person(900, 150, 400)
    image = draw(grey, [here, there])
    drawn = make_detector("drawn")
    found = detect_expected(drawn, image, expected(here))
    assert len(drawn.detect(image)) == 2 and len(found) == 1
    np.testing.assert_allclose(found.keypoints_px[0], here, atol=1.0)
