"""What a camera foresees from its own boxes."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.pose import Poses2D
from e3pose.sight import Sight, look, own_occlusion

SIZE = (1000, 800)


def view(*centres: float) -> Poses2D:
    """Return people 100 px wide and 200 px high around x = centre, as two corner keypoints."""
    corners = [[[c - 50 / 1.1, 300.0], [c + 50 / 1.1, 500.0]] for c in centres]
    keypoints = np.array(corners).reshape(-1, 2, 2)
    return Poses2D(keypoints, np.ones(keypoints.shape[:2]))


def test_camera_that_never_looked_knows_nothing() -> None:
    assert np.isnan(own_occlusion(Sight.none(), 5, SIZE))


def test_boxes_move_on_with_their_motion_until_they_meet() -> None:
    sight = look(Sight.none(), view(200, 600), 0, SIZE)
    sight = look(sight, view(220, 580), 2, SIZE)  # 10 px a slot towards each other
    assert own_occlusion(sight, 3, SIZE) == 0
    assert own_occlusion(sight, 20, SIZE) == pytest.approx(1.0)  # 360 px apart closed in 18 slots


def test_newcomer_has_no_motion() -> None:
    sight = look(look(Sight.none(), view(200), 0, SIZE), view(205, 800), 1, SIZE)
    np.testing.assert_allclose(sight.motion[:, 0], [5, 0], atol=1e-9)


def test_empty_view_is_remembered_as_empty() -> None:
    sight = look(look(Sight.none(), view(200), 0, SIZE), view(), 1, SIZE)
    assert own_occlusion(sight, 4, SIZE) == 0.0
    assert sight.slot == 1


def test_people_who_left_the_image_do_not_count() -> None:
    sight = look(look(Sight.none(), view(800, 820), 0, SIZE), view(850, 870), 1, SIZE)
    assert own_occlusion(sight, 2, SIZE) > 0.1
    assert own_occlusion(sight, 20, SIZE) == 0.0
