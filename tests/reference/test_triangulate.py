"""Triangulation against known points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.reference.triangulate import noise_px, refine, reprojection_error, triangulate

from e3pose.model.camera import Camera, Rig


def ring(num_cameras: int, radius_m: float = 5.0, offset_m: float = 0.0) -> Rig:
    """Cameras on a ring, looking at a point 1 m above its centre; `offset_m` moves the world."""
    cameras = []
    for index in range(num_cameras):
        angle = 2 * np.pi * index / num_cameras + 0.2
        center = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), 2.5])
        forward = np.array([0, 0, 1.0]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[1000, 0, 500], [0, 1000, 400], [0, 0, 1.0]])
        center = center + [offset_m, -offset_m, 0]
        cameras.append(Camera.from_world_to_camera(f"c{index}", (1000, 800), K, R, -R @ center))
    return Rig(tuple(cameras))


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), num_views=st.integers(2, 8))
def test_project_then_triangulate_is_identity(seed: int, num_views: int) -> None:
    rng = np.random.default_rng(seed)
    rig = ring(num_views)
    points = rng.uniform((-1.5, -1.5, 0), (1.5, 1.5, 2), (3, 4, 3))
    scores = rng.uniform(0.1, 1.0, (num_views, 3, 4))
    keypoints = rig.project(points)
    found = triangulate(keypoints, scores, rig.projections)
    assert np.abs(found - points).max() < 1e-7
    refined, belief = refine(found, keypoints, scores, rig.projections, 3, reject_outliers=True)
    assert np.abs(refined - points).max() < 1e-7
    assert np.allclose(belief, 1)
    assert reprojection_error(refined, keypoints, scores, rig.projections).max() < 1e-4


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_permuting_views_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = ring(5)
    keypoints = rig.project(rng.uniform(-1, 1, (6, 3)) + [0, 0, 1])
    keypoints += rng.normal(size=keypoints.shape) * 5
    scores = rng.uniform(0.1, 1.0, keypoints.shape[:2])
    order = rng.permutation(5)
    first = triangulate(keypoints, scores, rig.projections)
    second = triangulate(keypoints[order], scores[order], rig.projections[order])
    assert np.abs(first - second).max() < 1e-9


def test_dlt_is_the_papers_equations_to_the_letter() -> None:
    rng = np.random.default_rng(1)
    rig = ring(4, offset_m=3.0)
    keypoints = rig.project(np.array([3.3, -3.2, 1.0])) + rng.normal(size=(4, 2)) * 10
    scores = np.array([0.9, 0.2, 0.6, 0.8])
    rows = []
    for (u, v), score, p in zip(keypoints, scores, rig.projections, strict=True):
        for row in (u * p[2] - p[0], v * p[2] - p[1]):
            rows.append(score / np.linalg.norm(row) * row)
    homogeneous = np.linalg.svd(np.stack(rows))[2][-1]
    expected = homogeneous[:3] / homogeneous[3]
    assert np.allclose(triangulate(keypoints, scores, rig.projections), expected, atol=1e-12)


def test_point_seen_once_or_never_is_nan() -> None:
    rig = ring(3)
    keypoints = rig.project(np.zeros((3, 3)))
    scores = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    keypoints[scores == 0] = np.nan
    points = triangulate(keypoints, scores, rig.projections)
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1:]).all()
    assert np.isnan(reprojection_error(points, keypoints, scores, rig.projections)[1:]).all()


@pytest.mark.parametrize("num_views", [0, 1])
def test_fewer_than_two_views_give_nan(num_views: int) -> None:
    projections = ring(3).projections[:num_views]
    points = triangulate(np.ones((num_views, 17, 2)), np.ones((num_views, 17)), projections)
    assert points.shape == (17, 3)
    assert np.isnan(points).all()


def test_point_behind_a_camera_that_saw_it_is_nan() -> None:
    rig = ring(2)
    behind = 2 * rig.centers_m[0] - np.array([0, 0, 1.0])
    homogeneous = rig.projections @ np.append(behind, 1.0)
    keypoints = homogeneous[:, :2] / homogeneous[:, 2:]
    assert np.isnan(triangulate(keypoints, np.ones(2), rig.projections)).all()


def test_refining_beats_the_dlt_on_noise_of_the_expected_size() -> None:
    rng = np.random.default_rng(2)
    rig = ring(5)
    points = rng.uniform((-1.5, -1.5, 0), (1.5, 1.5, 2), (2000, 3))
    scores = rng.uniform(0.1, 1.0, (5, 2000))
    keypoints = rig.project(points)
    keypoints += rng.normal(size=keypoints.shape) * noise_px(scores)[..., None]
    plain = triangulate(keypoints, scores, rig.projections)
    refined, _ = refine(plain, keypoints, scores, rig.projections, 2)
    error, refined_error = (np.linalg.norm(p - points, axis=-1).mean() for p in (plain, refined))
    assert refined_error < 0.85 * error


def test_rejecting_outliers_ignores_the_view_that_lies() -> None:
    rig = ring(5)
    point = np.array([0.2, -0.1, 1.2])
    keypoints = rig.project(point)
    keypoints[2] += [80, -60]
    scores = np.full(5, 0.9)
    plain = triangulate(keypoints, scores, rig.projections)
    kept, _ = refine(plain, keypoints, scores, rig.projections, 4)
    rejected, belief = refine(plain, keypoints, scores, rig.projections, 8, reject_outliers=True)
    assert np.linalg.norm(kept - point) > 0.03
    assert np.linalg.norm(rejected - point) < 0.002
    assert belief[2] < 0.01
    assert belief[[0, 1, 3, 4]].min() > 0.9


def test_noise_falls_with_the_score() -> None:
    noise = noise_px(np.linspace(0, 1, 50))
    assert (np.diff(noise) <= 0).all()
    assert noise[0] > 5 * noise[-1]
