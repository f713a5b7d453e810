"""Crops of people who are expected, beside each other in one input of a network."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case
from tests.detectors.test_focus import expected, person

from e3pose.camera.orientation import turned
from e3pose.detectors.drawn import Drawn, draw
from e3pose.detectors.focus import (
    GAP,
    MOST_TILES,
    Mosaic,
    Part,
    Tile,
    apart,
    detect_expected,
    look_at,
    mosaic_of,
    pack,
)
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

SIZE = (1920, 1080)
WHOLE = 512 * 288


class Network:
    """An input of any size in which people of 200 pixels are found best."""

    person_px, long_side, multiple, free_input = 200.0, 512, 32, True


class Dots(Drawn):
    """Finds drawn people where the network would, and keeps what it looked at."""

    person_px, long_side, multiple = 400.0, 1920, 32
    free_input = True

    def __init__(self) -> None:
        super().__init__()
        self.shown: list[Any] = []

    def detect_part(self, image: Any, part: Part, expected: ExpectedView | None = None) -> Poses2D:
        self.shown.append((image.shape[1::-1], part, expected))
        return super().detect_part(image, part, expected)


def look(*people: Any, network: Any = None) -> Part | Mosaic | None:
    return look_at(expected(*people), SIZE, network or Network())


box_lists = st.lists(
    st.tuples(st.floats(0, 900), st.floats(0, 500), st.floats(1, 400), st.floats(1, 400)).map(
        lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
    ),
    min_size=1,
    max_size=12,
)


@given(box_lists)
def test_rectangles_hold_their_boxes_and_do_not_overlap(boxes: list[Any]) -> None:
    groups = apart(np.array(boxes))
    assert sorted(n for _, members in groups for n in members) == list(range(len(boxes)))
    for (left, top, right, bottom), members in groups:
        for box in (boxes[n] for n in members):
            assert left <= box[0] and top <= box[1] and box[2] <= right and box[3] <= bottom
    for number, (one, _) in enumerate(groups):
        for other, _ in groups[number + 1 :]:
            assert one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or (
                other[3] <= one[1]
            )  # fmt: skip


def test_box_that_joins_two_makes_them_one_crop_and_a_missing_box_is_in_none() -> None:
    boxes = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [np.nan] * 4, [9, 0, 21, 5], [40, 0, 50, 9]])
    assert apart(boxes) == [((0, 0, 30, 10), (0, 1, 3)), ((40, 0, 50, 9), (4,))]


@given(st.lists(st.tuples(st.integers(1, 400), st.integers(1, 400)), min_size=1, max_size=8))
def test_packed_rectangles_are_inside_and_apart(sizes: list[tuple[int, int]]) -> None:
    corners, (width, height) = pack(sizes, 32)
    assert width % 32 == 0 and height % 32 == 0
    places = [(x, y, x + w, y + h) for (x, y), (w, h) in zip(corners, sizes, strict=True)]
    for number, (left, top, right, bottom) in enumerate(places):
        assert left >= 0 and top >= 0 and right <= width and bottom <= height
        for other in places[number + 1 :]:
            assert (
                right + GAP <= other[0]
                or other[2] + GAP <= left
                or bottom + GAP <= other[1]
                or other[3] + GAP <= top
            )


def test_people_of_equal_size_are_packed_without_waste() -> None:
    _, size = pack([(80, 248)] * 3, 32)
    assert size == (256, 256)
    _, size = pack([(90, 120)] * 4, 32)
    assert size[0] * size[1] == 192 * 256  # two by two, or four above each other


@given(
    st.tuples(st.integers(0, 900), st.integers(0, 500), st.integers(1, 900), st.integers(1, 500)),
    st.tuples(st.integers(0, 300), st.integers(0, 300)),
    st.tuples(st.integers(1, 300), st.integers(1, 300)),
)
def test_points_go_there_and_back(box: Any, corner: Any, size: Any) -> None:
    tile = Tile((box[0], box[1], box[0] + box[2], box[1] + box[3]), corner, size)
    points = np.array([[0.0, 0.0], [812.3, 77.7], [np.nan, np.nan]])
    np.testing.assert_allclose(tile.to_image(tile.to_mosaic(points)), points, atol=1e-6)
    edges = np.array([[box[0], box[1]], [box[0] + box[2], box[1] + box[3]]]) - 0.5
    there = tile.to_mosaic(edges) + 0.5
    np.testing.assert_allclose(there, [corner, np.add(corner, size)], atol=1e-9)


def test_two_people_apart_are_looked_at_in_crops_at_their_best_sizes() -> None:
    far, near = person(200, 300, 150), person(1200, 200, 600)
    mosaic = look(far, near)
    assert isinstance(mosaic, Mosaic) and mosaic.relative_size == 1.0
    shown = mosaic.expected(expected(far, near)).keypoints_px
    assert np.ptp(shown[..., 1], axis=1) == pytest.approx([200, 200], rel=0.02)
    reach = mosaic.expected(expected(far, near, reach=30.0)).reach_px
    assert reach == pytest.approx([30 * 200 / 150, 30 * 200 / 600], rel=0.02)
    alone = Network()
    alone.free_input = False
    part = look(far, near, network=alone)
    assert isinstance(part, Part)
    assert mosaic.pixels < 0.6 * part.long_side**2 * min(part.size) / max(part.size)


@each_case(
    ("people", "kind"),
    [
        ([(1584, 815, 296), (1869, 921, 528)], Part),  # as large in it, for fewer pixels
        ([(292, 738, 701), (385, 770, 42), (804, 586, 468)], Part),  # larger in it
        ([(487, 55, 390), (24, 59, 208), (1782, 563, 551), (1276, 892, 481)], Mosaic),  # likewise
    ],
)
def test_way_with_larger_people_or_else_fewer_pixels_is_chosen(
    people: list[tuple[float, float, float]], kind: type[Any]
) -> None:
    assert isinstance(look(*(person(*each) for each in people)), kind)


def test_somebody_far_away_is_enlarged_so_far_and_no_further() -> None:
    mosaic = look(person(100, 100, 40), person(1500, 500, 400))
    assert isinstance(mosaic, Mosaic) and mosaic.relative_size == 1.0
    assert mosaic.tiles[0].scale == pytest.approx([2.0, 2.0], rel=0.02)


def test_people_whose_boxes_overlap_share_a_crop() -> None:
    assert isinstance(look(person(300, 200, 400), person(380, 220, 400)), Part)
    mosaic = look(person(100, 200, 400), person(180, 220, 400), person(1500, 200, 300))
    assert isinstance(mosaic, Mosaic) and mosaic.groups == ((0, 1), (2,))


def test_too_many_crops_are_one_part() -> None:
    people = [person(40 + 200 * n, 100 + 500 * (n % 2), 90) for n in range(MOST_TILES + 1)]
    assert isinstance(look(*people), Part)
    assert isinstance(look(*people[:4]), Mosaic)


@given(
    st.lists(
        st.tuples(st.floats(-300, 2000), st.floats(-300, 1200), st.floats(20, 2000)),
        min_size=1,
        max_size=10,
    ),
    st.floats(0, 300),
)
def test_look_costs_no_more_than_the_whole_image_and_crops_hold_who_they_are_of(
    people: list[Any], reach: float
) -> None:
    view, network = expected(*(person(*each) for each in people), reach=reach), Network()
    found = look_at(view, SIZE, network)
    if not isinstance(found, Mosaic):
        return
    assert found.pixels <= WHOLE and found.pixels == found.size[0] * found.size[1]
    assert all(side % network.multiple == 0 for side in found.size)
    there = found.expected(view)
    for tile, group in zip(found.tiles, found.groups, strict=True):
        assert min(tile.box) >= 0 and tile.box[2] <= SIZE[0] and tile.box[3] <= SIZE[1]
        points = view.keypoints_px[list(group)]
        seen = ((points >= 0) & (points <= np.array(SIZE) - 1)).all(axis=-1)
        assert tile.holds(there.keypoints_px[list(group)])[seen].all()


def test_crops_are_smaller_where_they_would_cost_too_much() -> None:
    boxes = np.array([[0, 0, 400, 1000], [600, 0, 1000, 1000]], dtype=float)
    sizes = np.array([800.0, 800.0])
    full = mosaic_of(boxes, sizes, 200.0, 2.0, 32, WHOLE)
    less = mosaic_of(boxes, sizes, 200.0, 2.0, 32, 40_000)
    assert full is not None and full.relative_size == 1.0
    assert less is not None and less.pixels <= 40_000 and 0.5 < less.relative_size < 1
    assert mosaic_of(boxes, sizes, 200.0, 2.0, 32, 1) is None


def test_each_person_is_found_once_where_they_are_in_the_image() -> None:
    here, beside, there = person(200, 150, 400), person(310, 180, 400), person(1400, 300, 600)
    image = draw(np.full((1080, 1920, 3), 24, dtype=np.uint8), [here, beside, there])
    dots = Dots()
    found = detect_expected(dots, image, expected(here, beside, there))
    (size, part, shown), *more = dots.shown
    assert not more and size == part.size and size[0] * size[1] < 0.5 * 1920 * 1080
    assert shown is not None and len(shown) == 3
    assert len(found) == 3  # `beside` is partly in the box of `here`
    order = np.argsort(np.nanmean(found.keypoints_px[..., 0], axis=1))
    for one, truth in zip(found.keypoints_px[order], (here, beside, there), strict=True):
        np.testing.assert_allclose(one, truth, atol=1.5)


@each_case("degrees", [90, 180, 270])
def test_crops_of_turned_images_are_upright(degrees: int) -> None:
    here, there = person(200, 150, 400), person(1400, 300, 600)
    image = draw(np.full((1080, 1920, 3), 24, dtype=np.uint8), [here, there])
    dots = Dots()
    found = detect_expected(turned(dots, degrees), image, expected(here, there))
    (size, _, shown), *more = dots.shown
    assert not more and size[0] * size[1] < 0.5 * 1920 * 1080 and shown is not None
    along = 0 if degrees in (90, 270) else 1  # of the people, who lie in the turned image
    assert np.ptp(shown.keypoints_px[..., along], axis=1) == pytest.approx([400, 400], rel=0.02)
    order = np.argsort(np.nanmean(found.keypoints_px[..., 0], axis=1))
    np.testing.assert_allclose(found.keypoints_px[order], [here, there], atol=1.5)


def test_somebody_between_crops_is_not_in_them() -> None:
    here, between, there = person(100, 300, 300), person(900, 300, 300), person(1600, 300, 300)
    image = draw(np.full((1080, 1920, 3), 24, dtype=np.uint8), [here, between, there])
    assert len(detect_expected(Dots(), image, expected(here, there))) == 2
    assert len(detect_expected(Dots(), image, None)) == 3


def test_keypoints_outside_of_a_persons_crop_are_dropped() -> None:
    tiles = (Tile((0, 0, 100, 100), (0, 0), (50, 50)), Tile((500, 0, 600, 100), (66, 0), (50, 50)))
    mosaic = Mosaic(tiles, (128, 64), ((0,), (1,)), 1.0)
    keypoints_px = np.array([[[10, 10], [20, 20], [70, 10]], [[58, 10], [58, 11], [np.nan] * 2]])
    scores = np.array([[0.5, 0.5, 0.9], [0.5, 0.5, 0.0]])
    found = mosaic.in_image(Poses2D(keypoints_px, scores))
    assert len(found) == 1  # the other stands between the crops
    np.testing.assert_allclose(found.keypoints_px[0], [[20.5, 20.5], [40.5, 40.5], [np.nan] * 2])
    assert found.scores.tolist() == [[0.5, 0.5, 0.0]]
    assert len(mosaic.in_image(Poses2D.empty(3))) == 0
