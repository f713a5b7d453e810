"""Bundle adjustment: derivatives, and the truth from a start that is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.calibrate.people_scenes import distances, disturbed

from e3pose.calibrate.bundle import AdjustOptions, adjust_points, observe
from e3pose.calibrate.from_points import adjust_all, pair_poses, solve_points
from e3pose.calibrate.moved_cameras import Cameras, placed
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig

LONGER = np.array([np.log(1.12), 0.0, 0.0, 0.0])  # a lens of 1.12 times the focal length
RIG = Rig(
    tuple(
        replace(camera, distortion=np.array([-0.2, 0.06, 0.001, 0.0]))
        for camera in ring_rig(4, 4.0, 2.0, (1280, 720), np.random.default_rng(0)).cameras
    )
)


def seen(rng: np.random.Generator, number: int, noise_px: float):  # type: ignore[no-untyped-def]
    points = rng.uniform([-1.5, -1.5, 0.1], [1.5, 1.5, 2.0], (number, 3))
    pixels = RIG.project(points) + rng.normal(0, noise_px, (len(RIG), number, 2))
    outside = ~np.stack([camera.sees(points) for camera in RIG.cameras])
    pixels[outside | (rng.random(outside.shape) < 0.2)] = np.nan
    return points, pixels


def test_points_are_triangulated_and_outliers_left_out() -> None:
    rng = np.random.default_rng(1)
    points, pixels = seen(rng, 200, 0.0)
    sigma = np.full(pixels.shape[:2], 2.0)
    enough = np.isfinite(pixels[..., 0]).sum(axis=0) == 4
    found = place_points(RIG, pixels, sigma)
    assert np.allclose(found[enough], points[enough], atol=1e-6)
    wrong = pixels.copy()
    wrong[0] += 60.0
    found = place_points(RIG, wrong, sigma)
    assert np.median(np.linalg.norm(found - points, axis=1)[enough]) < 0.01
    alone = np.isfinite(pixels[..., 0]).sum(axis=0) < 2
    assert np.isnan(found[alone]).all()


def test_rig_is_found_from_a_start_that_is_off_despite_outliers() -> None:
    rng = np.random.default_rng(2)
    points, pixels = seen(rng, 500, 2.0)
    wild = rng.random(pixels.shape[:2]) < 0.1
    pixels[wild] += rng.normal(0, 100, (int(wild.sum()), 2))
    start = disturbed(RIG, 5.0, 0.2, 3)
    rough = points + rng.normal(0, 0.1, points.shape)
    sigma = np.full(pixels.shape[:2], 2.0)
    result = adjust_points(start, rough, pixels, sigma, AdjustOptions(2.5))
    degrees, millimetres, _ = distances(result.rig, RIG)
    assert degrees < 0.1 and millimetres < 6
    assert result.weights[..., 0][wild & (result.weights[..., 0] > 0)].mean() < 0.3


def test_solution_is_that_of_a_general_solver() -> None:
    rng = np.random.default_rng(3)
    points, pixels = seen(rng, 25, 1.0)
    keep = np.isfinite(pixels[..., 0]).sum(axis=0) >= 3
    points, pixels = points[keep], pixels[:, keep]
    start = disturbed(RIG, 0.5, 0.02, 4)
    sigma = np.ones(pixels.shape[:2])
    ours = adjust_points(start, points, pixels, sigma, AdjustOptions(np.inf))
    observed = observe(start, pixels[:, :, None], sigma[:, :, None])

    def residuals(x: np.ndarray) -> np.ndarray:
        steps = np.zeros((4, 10))
        steps[1:, :6] = x[:18].reshape(3, 6)
        cameras, moved = Cameras.of(start).moved(steps), points + x[18:].reshape(-1, 3)
        inside = np.einsum("cij,pj->cpi", cameras.rotations, moved) + cameras.translations[:, None]
        ideal = inside[..., :2] / inside[..., 2:]
        off = ideal - observed.points[:, :, 0]
        return np.asarray(np.einsum("cpuv,cpv->cpu", observed.whiten[:, :, 0], off).ravel())

    theirs = least_squares(residuals, np.zeros(18 + points.size), x_scale="jac", xtol=1e-12)
    ours_cost = 0.5 * np.nansum(ours.residuals**2)
    assert ours_cost == pytest.approx(theirs.cost, rel=1e-4)


def test_rig_is_found_from_nothing_and_focal_lengths_too() -> None:
    rng = np.random.default_rng(5)
    _, pixels = seen(rng, 400, 2.0)
    home = Rig(tuple(placed(camera, np.eye(3), np.zeros(3)) for camera in RIG.cameras))
    sigma = np.full(pixels.shape[:2], 2.0)
    found = solve_points(home, pixels, sigma, pair_poses(home, pixels, sigma))
    assert found is not None and found.placed.all()
    degrees, millimetres, _ = distances(found.adjusted.rig, RIG)
    assert degrees < 0.15 and millimetres < 8
    free = np.zeros((4, 4, 4, 4))
    free[:, 0, :, 0] = 0.25**2 * np.eye(4)
    guessed = Rig(tuple(placed(camera, np.eye(3), np.zeros(3), LONGER) for camera in RIG.cameras))
    found = solve_points(guessed, pixels, sigma, pair_poses(guessed, pixels, 2 * sigma), free)
    assert found is not None
    for camera, truth in zip(found.adjusted.rig.cameras, RIG.cameras, strict=True):
        assert camera.K[0, 0] == pytest.approx(truth.K[0, 0], rel=0.02)


def test_one_coefficient_bends_as_real_lenses_do() -> None:
    # A wide lens of a real rig (1920 x 1080), whose second coefficient counterweighs the first.
    K = np.array([[1396.0, 0, 960], [0, 1396, 540], [0, 0, 1]])
    bent = np.array([-0.282, 0.168, 0.0, 0.0])
    real = replace(RIG.cameras[0], image_size=(1920, 1080), K=K, distortion=bent)
    plain = replace(real, distortion=np.zeros(0), lens_assumed=True)
    found = placed(plain, plain.R, plain.t, np.array([0.0, -0.27, 0.0, 0.0]))
    aside = np.linspace(0, 0.69, 20)
    points = np.stack([aside, 0 * aside, 1 + 0 * aside], axis=-1) @ real.R + real.center_m
    assert np.abs(found.project(points) - real.project(points)).max() < 1.5  # pixels


def test_a_rig_in_which_a_camera_runs_away_is_none() -> None:
    _, pixels = seen(np.random.default_rng(5), 200, 0.5)
    farthest = np.abs(RIG.centers_m).max(axis=1)
    fixed = int(np.argmin(farthest))  # at its place the others are beyond a kilometre
    stretch = np.full(4, 0.6 * 1000 / farthest.max())
    stretch[fixed] = 0.5 * (1000 / farthest.max() + 1000 / farthest[fixed])
    order = [fixed, *(i for i in range(4) if i != fixed)]  # the first stays
    cameras = [
        placed(RIG.cameras[i], RIG.cameras[i].R, -stretch[i] * RIG.cameras[i].R @ RIG.centers_m[i])
        for i in order
    ]
    sigma, everyone = np.full((4, pixels.shape[1]), 0.5), np.ones(4, dtype=bool)
    assert adjust_all(Rig(tuple(cameras)), pixels[order], sigma, everyone) is None
