"""Lines of sight against bodies and things of known place and size."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.simulate.body import Posture, draw_body, joints_of
from e3pose.simulate.hidden_joints import behind_things, covered_by_others, covered_by_self
from e3pose.simulate.occluders import Box, Occluder, Pillar


def standing(x_m: float, y_m: float, yaw: float = 0.0) -> Floats:
    """One upright person with hanging arms: (17, 3)."""
    body = draw_body(np.random.default_rng(3))
    angles = np.array([[yaw, 0.0, 0.0]])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    hip = np.array([x_m, y_m, body.ankle_height + 0.99 * body.leg])
    ankles = np.stack([[x_m, y_m, body.ankle_height] + side * 0.1 * left for side in (1, -1)])
    arms = np.broadcast_to([0.0, 0.15, 0.2, 0.3], (1, 2, 4))
    joints: Floats = joints_of(
        body, Posture(hip[None], angles, angles, angles, angles[:, 0], ankles[None], arms)
    )[0]
    return joints


CAMERA = np.array([5.0, 0.0, 1.3])


def test_person_right_behind_another_is_covered_and_not_the_other_way_round() -> None:
    people = np.stack([standing(0.0, 0.0), standing(1.5, 0.0)])[None]
    cover = covered_by_others(CAMERA, people)[0]
    assert (cover[0] > 0.5).sum() >= 9
    assert cover[1].max() == 0


def test_person_beside_another_is_not_covered() -> None:
    people = np.stack([standing(0.0, 0.0), standing(1.5, 1.5)])[None]
    assert covered_by_others(CAMERA, people).max() == 0


def test_people_who_are_away_cover_nobody() -> None:
    people = np.stack([standing(0.0, 0.0), np.full((17, 3), np.nan)])[None]
    assert covered_by_others(CAMERA, people).max() == 0
    assert covered_by_self(CAMERA, people)[0, 1].max() == 0


def test_face_shows_to_a_camera_in_front_and_hides_from_behind() -> None:
    facing, away = standing(0.0, 0.0, 0.0), standing(0.0, 0.0, np.pi)
    cover = covered_by_self(CAMERA, np.stack([facing, away])[None])[0]
    assert cover[0, :3].max() == 0
    assert cover[1, :3].min() > 0.5


def test_far_arm_hides_behind_the_torso_in_profile() -> None:
    # Facing +y, the right arm is towards the camera and the left one behind the body.
    person = standing(0.0, 0.0, np.pi / 2)
    cover = covered_by_self(CAMERA, person[None, None])[0, 0]
    assert cover[5] > 0.5 and cover[7] > 0.5
    assert cover[6] == 0 and cover[8] == 0


PILLAR = Pillar(1.0, 0.0, 0.2, 2.0)
BOX = Box(1.0, 0.0, 0.4, 2.0, 1.0)


@each_case(
    ("thing", "start", "end", "expected"),
    [
        (PILLAR, (3, 0, 1), (0, 0, 1), True),
        (PILLAR, (3, 0.21, 1), (0, 0.21, 1), False),
        (PILLAR, (3, 0.19, 1), (0, 0.19, 1), True),
        (PILLAR, (3, 0, 2.1), (0, 0, 2.1), False),  # over the top
        (PILLAR, (3, 0, 3.0), (0, 0, 0.5), True),  # down through the side
        (PILLAR, (3, 0, 1), (1.3, 0, 1), False),  # stops before it
        (PILLAR, (1, 0, 3), (1, 0, 1), True),  # straight down into it
        (BOX, (3, 0, 0.5), (0, 0, 0.5), True),
        (BOX, (3, 0.9, 0.5), (0, 0.9, 0.5), True),
        (BOX, (3, 1.1, 0.5), (0, 1.1, 0.5), False),
        (BOX, (3, 0, 1.1), (0, 0, 1.1), False),
        (BOX, (3, 0, 2.0), (0, 0, 0.0), True),  # at x = 1.2 it is 0.8 m high
        (Box(1.0, 0.0, 0.4, 2.0, 1.0, yaw=np.pi / 2), (3, 0.3, 0.5), (0, 0.3, 0.5), False),
    ],
)
def test_line_of_sight(
    thing: Occluder,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    expected: bool,
) -> None:
    assert bool(thing.blocks(np.array(start), np.array(end))) is expected


def test_nearest_point_of_a_footprint() -> None:
    assert PILLAR.nearest(np.array([3.0, 0.0])) == pytest.approx([1.2, 0.0])
    assert BOX.nearest(np.array([3.0, 0.5])) == pytest.approx([1.2, 0.5])
    assert BOX.nearest(np.array([1.0, 5.0])) == pytest.approx([1.0, 1.0])


def test_things_hide_people_behind_them_only() -> None:
    people = np.stack([standing(0.0, 0.0), standing(3.0, 0.0)])[None]
    wall = Box(1.5, 0.0, 0.1, 3.0, 2.5)
    hidden = behind_things(CAMERA, people, [wall])[0]
    assert hidden[0].all() and not hidden[1].any()
    assert not behind_things(CAMERA, people, []).any()
