"""Turns by viewing angle, and looks that are asked for."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from tests.cases import each_case
from tests.rigs import around
from tests.select.test_awake import KNOWN, RIG, situation
from tests.select.test_expected_information import outlook, person

from e3pose.model.camera import Camera, Rig
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select.camera_order import spread_order, viewing_angles
from e3pose.select.expected_information import foresee
from e3pose.select.requested import asked_for, with_requested


@each_case(("num_cameras", "least_deg"), [(2, 170), (3, 110), (5, 130), (8, 125)])
def test_neighbours_in_the_order_look_from_far_apart(num_cameras: int, least_deg: float) -> None:
    rng = np.random.default_rng(num_cameras)
    angles = rng.permutation(np.linspace(0, 2 * np.pi, num_cameras, endpoint=False))
    rig = around(
        angles.tolist(), 20.0, 2.0
    )  # far away and low, so that directions are nearly level
    order = np.array(spread_order(rig))
    assert sorted(order.tolist()) == list(range(num_cameras))
    assert order[0] == 0
    apart = np.degrees(viewing_angles(rig)[order, np.roll(order, 1)])
    assert (apart > least_deg).all()


def test_two_clusters_are_visited_in_turn_and_any_rig_has_an_order() -> None:
    rig = around(np.radians([0.0, 5, 10, 180, 185, 190]).tolist(), 4.0, 2.0)
    groups = [camera // 3 for camera in spread_order(rig)]
    assert all(a != b for a, b in pairwise(groups))
    for tiny in (1, 2):
        assert spread_order(around(range(tiny), 4.0, 2.0)) == tuple(range(tiny))
    K = np.array([[900.0, 0, 500], [0, 900, 400], [0, 0, 1]])
    parallel = (
        Camera.from_world_to_camera(f"c{i}", (1000, 800), K, np.eye(3), [-float(i), 0, 0])
        for i in range(4)
    )
    assert sorted(spread_order(Rig(tuple(parallel)))) == [0, 1, 2, 3]


SEEN = outlook(np.stack([person(0, 0), person(1, -1)]), RIG)
NOW = situation(foresee(RIG, SEEN, 0.04), KNOWN)
ONE = np.arange(5) == 0


def test_a_second_camera_is_added_and_no_third_where_it_is_asked_for_and_can_be() -> None:
    found = with_requested(ONE, NOW, LookRequest(2.0))
    assert found[0] and found.sum() == 2
    assert (with_requested(found, NOW, LookRequest(2.0)) == found).all()
    assert (with_requested(ONE, NOW, NO_REQUEST) == ONE).all()
    for alone in (replace(NOW, online=ONE), replace(NOW, foresight=None)):
        assert (with_requested(ONE, alone, LookRequest(2.0)) == ONE).all()


def test_who_is_asked_for_weighs_alone_where_they_are_there() -> None:
    assert NOW.foresight is not None
    weights = asked_for(NOW.foresight, LookRequest(2.0, (int(SEEN.expected.track_ids[1]),))).weights
    before = NOW.foresight.weights
    assert weights[1] == before[1] > weights[0] == 0
    assert (asked_for(NOW.foresight, LookRequest(2.0, (99,))).weights == before).all()
