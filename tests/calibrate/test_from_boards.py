"""Cameras placed by a board that only pairs of them see."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.calibrate.people_scenes import distances
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.calibrate.board import Board
from e3pose.calibrate.from_boards import (
    Edge,
    board_on_floor,
    chain,
    connected,
    robust_mean,
    solve_boards,
)
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig

BOARD = Board.parse("charuco-5x7-54mm")
A4 = Board.parse("charuco-5x7-37mm")
RIG = ring_rig(5, 4.0, 2.0, (1280, 720), np.random.default_rng(0))


def carried(rng: np.random.Generator, number: int, two_sided: bool = False) -> np.ndarray:
    """Return corners of a board that is carried about, seen from its front or from both sides."""
    pixels = np.full((len(RIG), number, len(BOARD.corners_m), 2), np.nan)
    middle = BOARD.corners_m.mean(axis=0)
    for time in range(number):
        place = np.array([*rng.uniform(-1.2, 1.2, 2), rng.uniform(0.8, 1.6)])
        turn = Rotation.from_euler("Z", rng.uniform(0, 2 * np.pi)).as_matrix()
        turn = turn @ Rotation.from_euler("X", -np.pi / 2 + rng.uniform(-0.4, 0.4)).as_matrix()
        corners = (BOARD.corners_m - middle) @ turn.T + place
        for index, camera in enumerate(RIG.cameras):
            to_camera = camera.center_m - place
            facing = -(turn[:, 2] @ to_camera) / np.linalg.norm(to_camera)
            if (abs(facing) if two_sided else facing) > 0.4 and camera.sees(corners).all():
                pixels[index, time] = camera.project(corners) + rng.normal(0, 0.3, (24, 2))
    return pixels


def test_rig_is_found_though_no_camera_sees_all_and_boards_are_misread() -> None:
    rng = np.random.default_rng(1)
    pixels = carried(rng, 80)
    solved = solve_boards(RIG, BOARD.corners_m, pixels)
    assert (solved.together == 0).any()
    assert solved.errors_px == pytest.approx(0.3 * np.sqrt(2), rel=0.2)
    wrong = pixels.copy()
    wrong[1, :6] += rng.normal(0, 30, pixels[1, :6].shape)
    wrong[3, 10:16] += 15.0  # a film that stutters
    for rig in (solved.adjusted.rig, solve_boards(RIG, BOARD.corners_m, wrong).adjusted.rig):
        degrees, millimetres, scale = distances(rig, RIG)
        assert degrees < 0.1 and millimetres < 10
        assert scale == pytest.approx(1, abs=0.002)


def test_two_sided_board_joins_cameras_that_face_each_other() -> None:
    pixels = carried(np.random.default_rng(4), 20, two_sided=True)
    solved = solve_boards(RIG, BOARD.corners_m, pixels)
    assert (solved.together > 0).all()  # of 20 places
    degrees, millimetres, _ = distances(solved.adjusted.rig, RIG)
    assert degrees < 0.1 and millimetres < 10


def test_camera_without_company_is_named() -> None:
    pixels = carried(np.random.default_rng(3), 60)
    pixels[2, np.isfinite(pixels[[0, 1, 3, 4], :, 0, 0]).any(axis=0)] = np.nan
    with pytest.raises(InputError, match=r"cameras: cam2: never saw the board at the same time as"):
        solve_boards(RIG, BOARD.corners_m, pixels)


def test_board_on_the_floor_is_placed() -> None:
    truth = np.eye(4)
    truth[:3, :3] = np.diag([1.0, -1.0, -1.0])
    truth[:3, 3] = [0.3, -0.2, 0.0]
    corners = BOARD.corners_m @ truth[:3, :3].T + truth[:3, 3]
    found = board_on_floor(RIG, BOARD.corners_m, RIG.project(corners))
    assert np.allclose(found, truth, atol=1e-5)
    with pytest.raises(InputError, match="--floor: found no board"):
        board_on_floor(RIG, BOARD.corners_m, np.full((5, 24, 2), np.nan))


def thrown(seed: int, cameras: int, noise_px: float) -> tuple[Rig, np.ndarray, np.ndarray]:
    """Return a rig, an A4 board's rotation as it lies on its floor, and its corners in pixels."""
    rng = np.random.default_rng(seed)
    rig = RIG.subset(rng.permutation(len(RIG))[:cameras].tolist())
    c, s = np.cos(angle := rng.uniform(0, 2 * np.pi)), np.sin(angle)
    turn = np.array([[c, s, 0], [s, -c, 0], [0, 0, -1.0]])
    lying = (A4.corners_m - A4.corners_m.mean(axis=0)) @ turn.T
    lying[:, :2] += rng.uniform(-1.0, 1.0, 2)
    pixels = rig.project(lying)
    return rig, turn, pixels + rng.normal(0, noise_px, pixels.shape)


@each_case(("cameras", "noise_px"), [(1, 0.2), (1, 0.5), (2, 0.5), (4, 0.5)])
def test_a_small_board_on_the_floor_is_never_mirrored(cameras: int, noise_px: float) -> None:
    refused = 0
    for seed in range(5):
        rig, turn, pixels = thrown(seed, cameras, noise_px)
        try:
            found = board_on_floor(rig, A4.corners_m, pixels)
        except InputError as error:
            assert "as likely tilted the other way" in str(error)
            refused += 1
            continue
        assert np.degrees(np.arccos(found[:3, 2] @ turn[:, 2])) < 8.0, seed
    assert refused == 0 or cameras == 1


def test_chain_takes_the_strongest_way() -> None:
    step, wrong = np.eye(4), np.eye(4)
    step[0, 3], wrong[0, 3] = 1.0, 9.0
    edges = {(0, 1): Edge(step, 5.0), (1, 2): Edge(step, 5.0), (0, 2): Edge(wrong, 1.0)}
    assert chain(4, edges, 0)[2, 0, 3] == pytest.approx(2.0)
    assert chain(4, edges, 2)[0, 0, 3] == pytest.approx(-2.0)
    assert np.isnan(chain(4, edges, 0)[3]).all()
    assert connected(4, edges) == [[0, 1, 2], [3]]


def test_mean_of_relative_poses_leaves_out_the_wrong() -> None:
    relative = np.repeat(np.eye(4)[None], 9, axis=0)
    relative[:, 0, 3] = 2.0
    relative[:3, 0, 3] = 5.0
    edge = robust_mean(relative)
    assert edge.T_first_second[0, 3] == pytest.approx(2.0) and edge.weight == 6
