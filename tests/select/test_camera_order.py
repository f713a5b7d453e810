"""Turns by viewing angle, and looks that are asked for."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case
from tests.select.test_awake import KNOWN, RIG, situation
from tests.select.test_expected_information import outlook, person

from e3pose.model.camera import Camera, Rig
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select.camera_order import spread_order, viewing_angles
from e3pose.select.expected_information import foresee
from e3pose.select.requested import asked_for, with_requested


def ring(angles: np.ndarray[tuple[int], np.dtype[np.float64]], radius_m: float = 4.0) -> Rig:
    """Cameras around (2, 1), all looking at its middle."""
    K = np.array([[900.0, 0, 500], [0, 900, 400], [0, 0, 1]])
    cameras = []
    for index, angle in enumerate(angles):
        centre = np.array([2 + radius_m * np.cos(angle), 1 + radius_m * np.sin(angle), 2.0])
        forward = np.array([2, 1, 1.0]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        cameras.append(Camera.from_world_to_camera(f"c{index}", (1000, 800), K, R, -R @ centre))
    return Rig(tuple(cameras))


@each_case(("num_cameras", "least_deg"), [(2, 170), (3, 110), (5, 130), (8, 125)])
def test_neighbours_in_the_order_look_from_far_apart(num_cameras: int, least_deg: float) -> None:
    rng = np.random.default_rng(num_cameras)
    angles = rng.permutation(np.linspace(0, 2 * np.pi, num_cameras, endpoint=False))
    rig = ring(angles, radius_m=20.0)  # far away and low, so that directions are nearly level
    order = np.array(spread_order(rig))
    assert sorted(order.tolist()) == list(range(num_cameras))
    assert order[0] == 0
    apart = np.degrees(viewing_angles(rig)[order, np.roll(order, 1)])
    assert (apart > least_deg).all()


def test_two_clusters_are_visited_in_turn() -> None:
    rig = ring(np.radians([0.0, 5, 10, 180, 185, 190]))
    groups = [camera // 3 for camera in spread_order(rig)]
    assert all(a != b for a, b in pairwise(groups))


@pytest.mark.parametrize("num_cameras", [1, 2])
def test_tiny_rigs_have_an_order(num_cameras: int) -> None:
    rig = ring(np.linspace(0, 1, num_cameras))
    assert spread_order(rig) == tuple(range(num_cameras))


def test_parallel_cameras_have_an_order() -> None:
    K = np.array([[900.0, 0, 500], [0, 900, 400], [0, 0, 1]])
    cameras = [
        Camera.from_world_to_camera(f"c{i}", (1000, 800), K, np.eye(3), [-float(i), 0, 0])
        for i in range(4)
    ]
    assert sorted(spread_order(Rig(tuple(cameras)))) == [0, 1, 2, 3]


SEEN = outlook(np.stack([person(0, 0), person(1, -1)]), RIG)
NOW = situation(foresee(RIG, SEEN, 0.04), KNOWN)
ONE = np.arange(5) == 0


def test_nothing_is_added_where_nothing_is_asked_for() -> None:
    assert (with_requested(ONE, NOW, NO_REQUEST) == ONE).all()


def test_a_second_camera_is_added_and_no_third() -> None:
    found = with_requested(ONE, NOW, LookRequest(2.0))
    assert found[0] and found.sum() == 2
    assert (with_requested(found, NOW, LookRequest(2.0)) == found).all()


def test_only_cameras_that_can_be_reached_are_added() -> None:
    there = replace(NOW, online=ONE)
    assert (with_requested(ONE, there, LookRequest(2.0)) == ONE).all()


def test_a_policy_without_foresight_decides_alone() -> None:
    blind = replace(NOW, foresight=None)
    assert (with_requested(ONE, blind, LookRequest(2.0)) == ONE).all()


def test_who_is_asked_for_weighs_alone_where_they_are_there() -> None:
    assert NOW.foresight is not None
    weights = asked_for(NOW.foresight, LookRequest(2.0, (int(SEEN.expected.track_ids[1]),))).weights
    before = NOW.foresight.weights
    assert weights[1] == before[1] > weights[0] == 0
    assert (asked_for(NOW.foresight, LookRequest(2.0, (99,))).weights == before).all()
