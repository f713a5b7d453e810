"""What a camera foresees from its own boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
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


def test_camera_that_never_looked_knows_nothing() -> None:
    assert np.isnan(foreseen(LastView.none(), 5))


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
