"""Lenses from views of a board, against lenses that are known."""

from __future__ import annotations

import numpy as np
import pytest
from tests.calibrate.board_pictures import corner_views, facing

from e3pose.base.errors import InputError
from e3pose.calibrate.board import Board
from e3pose.calibrate.intrinsics import advice, choose_views, fit_intrinsics, resect
from e3pose.model.camera import Camera

pytestmark = pytest.mark.slow

BOARD = Board.parse("charuco-5x7-36mm")
K = np.array([[900.0, 0, 650], [0, 905, 350], [0, 0, 1]])
WEBCAM = Camera("web", (1280, 720), K, np.eye(4), np.array([-0.25, 0.09, 0.001, -0.0005]))
FISHEYE = Camera(
    "fish", (1280, 960), np.array([[420.0, 0, 640], [0, 420, 480], [0, 0, 1]]), np.eye(4),
    np.array([0.05, -0.01, 0.003, -0.001]), True,
)  # fmt: skip


@pytest.mark.parametrize("camera", [WEBCAM, FISHEYE], ids=["pinhole", "fisheye"])
def test_lens_is_recognised_and_measured(camera: Camera) -> None:
    views = corner_views(camera, BOARD, 30, np.random.default_rng(3), noise_px=0.15)
    fit = fit_intrinsics("cam", camera.image_size, BOARD.corners_m, views, np.ones(len(views)))
    assert fit.model == ("fisheye" if camera.fisheye else "pinhole")
    assert fit.held_out_px[fit.model] == pytest.approx(0.15 * np.sqrt(2), rel=0.15)
    assert fit.camera.K[0, 0] == pytest.approx(camera.K[0, 0], rel=0.003)
    assert fit.camera.K[:2, 2] == pytest.approx(camera.K[:2, 2], abs=2.0)
    width, height = camera.image_size
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 9) * width, np.linspace(0.1, 0.9, 9) * height)
    rays = camera.rays(np.stack([x, y], axis=-1))
    moved = fit.camera.project(rays * 3.0) - np.stack([x, y], axis=-1)
    filmed = np.arccos(rays[..., 2]) < (fit.camera.known_to or np.pi) - 0.005
    assert filmed.sum() > 70
    # A lens that is a little off may be turned instead: what is left is its shape.
    moved = moved[filmed] - moved[filmed].mean(axis=0)
    assert np.linalg.norm(moved, axis=-1).max() < 1.5
    assert abs(fit.camera.K[0, 0] / camera.K[0, 0] - 1) < 4 * fit.focal_sigma


def test_blurred_and_misread_views_are_left_out() -> None:
    rng = np.random.default_rng(4)
    views = corner_views(WEBCAM, BOARD, 24, rng, noise_px=0.15)
    wrong = views.copy()
    wrong[3:6] += rng.normal(0, 8.0, views[3:6].shape)
    sharpness = np.ones(len(views))
    fit = fit_intrinsics("cam", WEBCAM.image_size, BOARD.corners_m, wrong, sharpness)
    assert not set(fit.used.tolist()) & {3, 4, 5}
    assert fit.camera.K[0, 0] == pytest.approx(900, rel=0.003)


def test_views_are_chosen_for_what_they_add() -> None:
    rng = np.random.default_rng(5)
    still = np.repeat(corner_views(WEBCAM, BOARD, 1, rng, 0.0), 100, axis=0)
    still = still + rng.normal(0, 0.1, still.shape)
    spread = corner_views(WEBCAM, BOARD, 20, rng, noise_px=0.1)
    views = np.concatenate([still, spread])
    chosen = choose_views(BOARD.corners_m, views, WEBCAM.image_size, np.ones(len(views)), 20)
    assert (chosen >= 100).sum() >= 18
    sharpness = np.where(np.arange(len(views)) < 110, 1.0, 0.1)  # half of them are blurred
    chosen = choose_views(BOARD.corners_m, views, WEBCAM.image_size, sharpness, 20)
    assert chosen.max() < 110


def test_advice_names_what_is_missing() -> None:
    rng = np.random.default_rng(6)
    views = corner_views(WEBCAM, BOARD, 60, rng, 0.0, share=(0.4, 0.6))
    assert advice(BOARD.corners_m, views, WEBCAM.image_size) == []
    left = np.where((views[..., :1] < 500), views, np.nan)
    words = "; ".join(advice(BOARD.corners_m, left[:8], WEBCAM.image_size))
    assert "record longer" in words
    assert "top right" in words and "top left" not in words


@pytest.mark.parametrize("camera", [WEBCAM, FISHEYE], ids=["pinhole", "fisheye"])
def test_gross_corners_do_not_bend_the_focal_length(camera: Camera) -> None:
    rng = np.random.default_rng(8)
    views = corner_views(camera, BOARD, 24, rng, noise_px=0.15)
    clean = fit_intrinsics("cam", camera.image_size, BOARD.corners_m, views, np.ones(len(views)))
    wrong = rng.random(views.shape[:2]) < 0.05
    views[wrong] += rng.normal(0, 15.0, (int(wrong.sum()), 2))
    fit = fit_intrinsics("cam", camera.image_size, BOARD.corners_m, views, np.ones(len(views)))
    assert fit.model == clean.model
    assert fit.camera.K[0, 0] == pytest.approx(camera.K[0, 0], rel=0.002)
    assert fit.fit_px < 2 * clean.fit_px
    assert len(fit.used) > 0.9 * len(views)  # corners are left out, not their views


def test_too_few_views_and_a_board_that_was_never_tilted_are_refused() -> None:
    rng = np.random.default_rng(9)
    few = corner_views(WEBCAM, BOARD, 4, rng, 0.1)
    aside = rng.uniform([-0.1, -0.05, 0.5], [0.1, 0.05, 0.9], (30, 1, 3))
    flat = WEBCAM.project(BOARD.corners_m - BOARD.corners_m.mean(axis=0) + aside)
    flat += rng.normal(0, 0.15, flat.shape)
    for views, message in (
        (few, "camera cam: found the board in 4 frames"),
        (flat, "found 0 views of a tilted board, expected at least 3"),
    ):
        with pytest.raises(InputError, match=message):
            fit_intrinsics("cam", WEBCAM.image_size, BOARD.corners_m, views, np.ones(len(views)))


def test_fisheye_lens_is_known_as_far_as_the_board_was_filmed() -> None:
    rng = np.random.default_rng(10)
    views = corner_views(FISHEYE, BOARD, 60, rng, noise_px=0.15)
    size = np.array(FISHEYE.image_size)
    near = np.linalg.norm(views - size / 2, axis=-1) < 300  # of 800 from the middle to a corner
    views = np.where(near[..., None], views, np.nan)
    views = views[np.isfinite(views[..., 0]).sum(axis=1) >= 8]
    fit = fit_intrinsics(
        "cam", FISHEYE.image_size, BOARD.corners_m, views, np.ones(len(views)), ("fisheye",)
    )
    assert fit.camera.known_to is not None
    assert np.degrees(fit.camera.known_to) == pytest.approx(np.degrees(300 / 420), abs=3)
    inside, outside = size / 2 + [250.0, 0.0], size / 2 + [450.0, 0.0]
    assert np.isfinite(fit.camera.normalise(inside)).all()
    assert np.isnan(fit.camera.undistort(outside)).all()
    assert np.isnan(fit.camera.rays(outside)).all()
    assert not fit.camera.sees(FISHEYE.rays(outside) * 2.0)


def test_board_is_placed_from_behind() -> None:
    placed = facing(WEBCAM, BOARD, np.array([0.1, 0.0, 0.7]), (0.3, np.pi - 0.4))
    corners = BOARD.corners_m @ placed[:3, :3].T + placed[:3, 3]
    boards, errors = resect(WEBCAM, BOARD.corners_m, WEBCAM.project(corners)[None])
    assert np.abs(errors).max() < 1e-3
    assert boards[0] == pytest.approx(placed, abs=1e-4)
