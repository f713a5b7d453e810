"""What cameras foresee: from their own boxes, and people predicted into their views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.select.feedback import expected_in_views, reach_m
from e3pose.select.motion_2d import LastView, own_occlusion, with_view

SIZE = (1000, 800)
K = np.array([[1000.0, 0, 500], [0, 1000, 400], [0, 0, 1]])
RIG = Rig((Camera.from_world_to_camera("only", SIZE, K, np.eye(3), np.zeros(3)),))


def foreseen(last: LastView, slot: int) -> float:
    return float(own_occlusion([last], slot, RIG)[0])


def view(*centres: float) -> Poses2D:
    """Return people 100 px wide and 200 px high around x = centre, as two corner keypoints."""
    corners = [[[c - 50 / 1.1, 300.0], [c + 50 / 1.1, 500.0]] for c in centres]
    keypoints = np.array(corners).reshape(-1, 2, 2)
    return Poses2D(keypoints, np.ones(keypoints.shape[:2]))


def test_boxes_move_on_with_their_motion_until_they_meet() -> None:
    last = with_view(LastView.none(), view(200, 600), 0, SIZE)
    last = with_view(last, view(220, 580), 2, SIZE)  # 10 px a slot towards each other
    assert foreseen(last, 3) == 0
    assert foreseen(last, 20) == pytest.approx(1.0)  # 360 px apart closed in 18 slots


def test_newcomer_has_no_motion() -> None:
    last = with_view(with_view(LastView.none(), view(200), 0, SIZE), view(205, 800), 1, SIZE)
    np.testing.assert_allclose(last.motion[:, 0], [5, 0], atol=1e-9)


def test_empty_view_is_remembered_as_empty() -> None:
    last = with_view(with_view(LastView.none(), view(200), 0, SIZE), view(), 1, SIZE)
    assert foreseen(last, 4) == 0.0
    assert last.slot == 1


def test_people_who_left_the_image_do_not_count() -> None:
    last = with_view(with_view(LastView.none(), view(800, 820), 0, SIZE), view(850, 870), 1, SIZE)
    assert foreseen(last, 2) > 0.1
    assert foreseen(last, 20) == 0.0


def test_cameras_with_different_numbers_of_people_do_not_mix() -> None:
    other = Camera.from_world_to_camera("other", (2000, 800), K, np.eye(3), np.zeros(3))
    rig = Rig((RIG.cameras[0], other, *(replace(other, camera_id=name) for name in "ab")))
    pair = with_view(LastView.none(), view(200, 250), 0, SIZE)
    wide = with_view(LastView.none(), view(1500, 1500, 300), 0, (2000, 800))
    alone = with_view(LastView.none(), view(1500), 0, (2000, 800))
    values = own_occlusion([pair, wide, alone, LastView.none()], 1, rig)
    np.testing.assert_allclose(values[:3], [1 / 3, 1 / 3, 0.0])  # one pair of 3; half a box of two
    assert np.isnan(values[3])


AHEAD = Camera.from_world_to_camera("ahead", SIZE, K, np.eye(3), np.zeros(3))
BACK = Camera.from_world_to_camera("back", SIZE, K, np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
SEEING = Rig((AHEAD, BACK))
FOUR_METRES_OFF = np.array([[[0.0, 0, 4], [0.2, 0.5, 4]]])  # one person, two joints


def test_person_is_where_the_camera_will_see_it() -> None:
    view, behind = expected_in_views(SEEING, FOUR_METRES_OFF, np.array([0.08]))
    np.testing.assert_allclose(view.keypoints_px, [[[500, 400], [550, 525]]])
    np.testing.assert_allclose(view.reach_px, [20])
    assert len(behind) == 0


def test_somebody_outside_the_image_is_expected_as_far_as_the_reach_goes() -> None:
    beside = FOUR_METRES_OFF + [2.1, 0, 0]  # 25 px to the right of the image
    assert len(expected_in_views(SEEING, beside, np.array([0.08]))[0]) == 0
    assert len(expected_in_views(SEEING, beside, np.array([0.12]))[0]) == 1


def test_joint_behind_the_camera_or_unknown_is_missing() -> None:
    joints_m = np.array([[[0.0, 0, 4], [0, 0, -1], [np.nan] * 3]])
    (view, _) = expected_in_views(SEEING, joints_m, np.array([0.1]))
    assert np.isfinite(view.keypoints_px[0]).all(axis=-1).tolist() == [True, False, False]


def test_reach_holds_nine_of_ten_joints_of_a_normal_error() -> None:
    off = np.linalg.norm(np.random.default_rng(0).normal(0, 0.05, (20_000, 3)), axis=1)
    reach = reach_m(np.full((1, 17), off.mean()), 0.1)
    assert (off < reach[0]).mean() == pytest.approx(0.9, abs=0.005)


def test_reach_without_a_stated_error_grows_with_the_time_ahead() -> None:
    unknown = np.full((2, 17), np.nan)
    near, far = reach_m(unknown, 0.04), reach_m(unknown, 0.5)
    assert (near > 0).all() and (near < far).all()
    known = np.where(np.arange(17) < 3, 0.02, np.nan)[None]
    assert reach_m(known, 0.5)[0] < near[0]


@each_case("middle_m", [-1.0, 0.0, 0.1, 0.29])
def test_somebody_nearer_than_the_least_depth_is_expected_as_if_there(middle_m: float) -> None:
    ahead_m = 0.5  # of one joint, which the camera sees
    joints_m = np.array([[[0.0, 0, ahead_m], [0, 0, 2 * middle_m - ahead_m]]])
    (view, _) = expected_in_views(SEEING, joints_m, np.array([0.06]))
    np.testing.assert_allclose(view.reach_px, [1000 * 0.06 / 0.3])
