"""Person boxes and the occlusion of eq. (4), against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case

from e3pose.model.camera import Camera, Rig
from e3pose.select.occlusion import Spread, box_iou, expected_views, occlusion, person_boxes

SIZE = (1000, 800)


def test_box_is_ten_percent_larger_than_the_joints_and_cut_at_the_image() -> None:
    keypoints = np.array([[100.0, 200.0], [300.0, 600.0], [np.nan, np.nan]])
    np.testing.assert_allclose(person_boxes(keypoints, SIZE), [90, 180, 310, 620])
    keypoints = np.array([[-50.0, 10.0], [50.0, 900.0], [20.0, 20.0]])
    np.testing.assert_allclose(person_boxes(keypoints, SIZE), [-0.5, -0.5, 55, 799.5])
    assert person_boxes(np.zeros((0, 17, 2)), SIZE).shape == (0, 4)


@each_case(
    "keypoints",
    [
        np.full((17, 2), np.nan),  # behind the camera
        np.array([[-10.0, 50.0], [-400.0, 300.0]]),  # left of the image
        np.array([[-10.0, 400.0], [1010.0, 400.0]]),  # astride it, with no joint inside
    ],
)
def test_people_out_of_view_do_not_count(keypoints: np.ndarray) -> None:
    assert np.isnan(person_boxes(keypoints, SIZE)).all()


def test_iou_of_known_boxes() -> None:
    first = np.array([0.0, 0.0, 10.0, 10.0])
    others = np.array([[5.0, 0, 15, 10], [20, 0, 30, 10], [0, 0, 10, 10], [np.nan] * 4])
    np.testing.assert_allclose(box_iou(first, others), [1 / 3, 0, 1, 0])


@each_case(
    ("boxes", "expected"),
    [
        (np.zeros((0, 4)), 0.0),
        (np.array([[0.0, 0, 10, 10]]), 0.0),  # one person hides nobody
        (np.array([[0.0, 0, 10, 10], [np.nan] * 4]), 0.0),
        (np.array([[0.0, 0, 10, 10], [0, 0, 10, 10]]), 1.0),
        # pairs: 1/3, 0, 1/3
        (np.array([[0.0, 0, 10, 10], [5, 0, 15, 10], [10, 0, 20, 10]]), 2 / 9),
    ],
)
def test_occlusion_is_the_mean_over_pairs(boxes: np.ndarray, expected: float) -> None:
    assert occlusion(boxes) == pytest.approx(expected)


def test_views_together_are_views_one_by_one() -> None:
    rng = np.random.default_rng(4)
    corners = rng.uniform(0, 300, (7, 5, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(1, 300, (7, 5, 2))], axis=-1)
    boxes[rng.uniform(size=(7, 5)) < 0.4] = np.nan
    np.testing.assert_allclose(occlusion(boxes), [occlusion(view) for view in boxes])


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.integers(0, 6))
def test_occlusion_is_a_share_and_ignores_the_order_of_people(seed: int, people: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 500, (people, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(1, 300, (people, 2))], axis=1)
    value = occlusion(boxes)
    assert 0 <= value <= 1
    assert occlusion(boxes[rng.permutation(people)]) == pytest.approx(value)


def test_two_people_in_line_hide_each_other_only_from_the_camera_in_that_line() -> None:
    K = np.array([[1000.0, 0, 500], [0, 1000, 400], [0, 0, 1]])
    along_x = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # looks along +x, z up
    along_y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    front = Camera.from_world_to_camera("front", SIZE, K, along_x, -along_x @ [-5.0, 0, 1])
    side = Camera.from_world_to_camera("side", SIZE, K, along_y, -along_y @ [0.0, -5, 1])
    body = np.array([[0.0, -0.2, 0.1], [0.0, 0.2, 0.1], [0.0, 0.0, 1.7], [0.2, 0.0, 1.0]])
    people = np.stack([body - [0.6, 0, 0], body + [0.6, 0, 0]])
    values = expected_views(Rig((front, side)), people)[0]
    assert values[0] > 0.5
    assert values[1] == 0.0


def test_inside_the_image_counts_whole_pixels() -> None:
    pixels = np.array([[-0.5, 0], [999.5, 799.5], [999.6, 0], [np.nan, 0]])
    seen = np.isfinite(person_boxes(pixels[:, None], SIZE)).all(axis=-1)
    assert seen.tolist() == [True, True, False, False]


def test_spread_is_the_usual_difference_between_cameras() -> None:
    spread = Spread()
    assert spread.mean == 0
    spread = spread.after(np.array([0.0, 0.2]), 0.04).after(np.array([0.1, 0.5]), 0.04)
    assert spread.mean == pytest.approx((0.1 + 0.2) / 2)
    assert spread.after(np.zeros(2), 0.04) == spread  # nobody hides anybody: nothing is learned
    assert spread.after(np.ones(1), 0.04) == spread  # of one camera neither


def test_spread_follows_a_site_that_changes_within_minutes() -> None:
    crowded, quiet = np.array([0.1, 0.5, 0.9]), np.array([0.01, 0.05, 0.09])
    spread = Spread()
    for _ in range(5000):
        spread = spread.after(crowded, 0.1)
    for _ in range(3000):  # five minutes
        spread = spread.after(quiet, 0.1)
    assert spread.mean == pytest.approx(float(quiet.std()), rel=0.1)
