"""Turns by viewing angle: where cameras look from decides, not how they are numbered."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.model.camera import Camera, Rig
from e3pose.select.camera_order import spread_order, viewing_angles


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
