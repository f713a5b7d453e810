"""Matching against known identities."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.reference.match import match, ray_distances

from e3pose.base.arrays import Floats

CAP_M = 0.3
MAX_DISTANCE_M = 0.1


def scene(
    rng: np.random.Generator, num_cameras: int, num_persons: int, noise_m: float = 0.0
) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Rays, centres, cameras and identities of people, 1.5 m apart, whom every camera sees."""
    angles = np.sort(rng.uniform(0, np.pi, num_cameras)) + 0.3 * np.arange(num_cameras)
    heights = rng.uniform(1.5, 3.0, num_cameras)
    centers = np.column_stack([8 * np.cos(angles), 8 * np.sin(angles), heights])
    spots = np.column_stack([1.5 * np.arange(num_persons), np.zeros((num_persons, 2))])
    joints = spots[:, None] + rng.uniform((-0.3, -0.3, 0.1), (0.3, 0.3, 1.8), (num_persons, 17, 3))
    cameras = np.repeat(np.arange(num_cameras), num_persons)
    persons = np.tile(np.arange(num_persons), num_cameras)
    rays = joints[persons] + noise_m * rng.normal(size=(len(persons), 17, 3))
    rays = rays - centers[cameras][:, None]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays, centers[cameras], cameras, persons


def as_sets(groups: list[list[int]], names: NDArray[np.int64]) -> set[frozenset[int]]:
    return {frozenset(int(names[pose]) for pose in group) for group in groups}


def test_distance_of_two_known_rays() -> None:
    rays = np.array([[[1.0, 0.0, 0.0]], [[0.0, -1.0, 0.0]]])
    centers = np.array([[0.0, 0.0, 0.0], [3.0, 2.0, 0.05]])  # they pass 5 cm apart at (3, 0)
    sums, weights = ray_distances(rays, centers, np.array([[0.8], [0.5]]), CAP_M)
    assert np.isclose(weights[0, 1], 0.5)
    assert np.isclose(sums[0, 1], 0.5 * 0.05)
    assert np.isclose(sums[1, 0], sums[0, 1])


def test_rays_that_meet_behind_a_camera_count_the_cap() -> None:
    rays = np.array([[[-1.0, 0.0, 0.0]], [[0.0, -1.0, 0.0]]])
    centers = np.array([[0.0, 0.0, 0.0], [3.0, 2.0, 0.0]])
    sums, _ = ray_distances(rays, centers, np.ones((2, 1)), CAP_M)
    assert np.isclose(sums[0, 1], CAP_M)


def test_parallel_rays_and_unseen_joints_say_nothing() -> None:
    rays = np.array([[[1.0, 0, 0], [1.0, 0, 0]], [[1.0, 0, 0], [0, 1.0, 0]]])
    centers = np.array([[0.0, 0, 0], [0, 1.0, 0]])
    sums, weights = ray_distances(rays, centers, np.array([[1.0, 0.0], [1.0, 1.0]]), CAP_M)
    assert weights[0, 1] == 0
    assert sums[0, 1] == 0


def test_nobody_gives_no_group() -> None:
    none = np.zeros(0, np.int64)
    assert match(np.zeros((0, 17, 3)), np.zeros((0, 3)), np.zeros((0, 17)), none, 0.1, 0.3) == []


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    num_cameras=st.integers(1, 6),
    num_persons=st.integers(1, 4),
)
def test_groups_are_the_people_in_any_order(seed: int, num_cameras: int, num_persons: int) -> None:
    rng = np.random.default_rng(seed)
    rays, centers, cameras, persons = scene(rng, num_cameras, num_persons, noise_m=0.01)
    scores = rng.uniform(0.5, 1.0, rays.shape[:2])
    order = rng.permutation(len(rays))
    groups = match(
        rays[order], centers[order], scores[order], cameras[order], MAX_DISTANCE_M, CAP_M
    )
    poses = np.arange(len(rays))
    expected = [list(poses[persons == person]) for person in range(num_persons)]
    if num_cameras == 1:
        expected = [[int(pose)] for pose in poses]
    assert as_sets(groups, order) == {frozenset(map(int, group)) for group in expected}
    strength = [scores[order][group].sum() for group in groups]
    assert strength == sorted(strength, reverse=True)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_scene_is_grouped_alike_in_any_order_and_never_twice_in_a_view(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rays, centers, cameras, _ = scene(rng, 5, 3, noise_m=0.15)  # too noisy to be right
    scores = np.where(rng.random(rays.shape[:2]) < 0.2, 0.0, rng.uniform(0, 1, rays.shape[:2]))
    same = np.arange(len(rays))
    order = rng.permutation(len(rays))
    first = match(rays, centers, scores, cameras, MAX_DISTANCE_M, CAP_M)
    second = match(
        rays[order], centers[order], scores[order], cameras[order], MAX_DISTANCE_M, CAP_M
    )
    assert as_sets(first, same) == as_sets(second, order)
    assert sorted(pose for group in first for pose in group) == list(same)
    for group in first:
        assert len({int(cameras[pose]) for pose in group}) == len(group)


def test_scrap_of_one_joint_is_not_joined_by_a_coincidence() -> None:
    rays, centers, cameras, _ = scene(np.random.default_rng(0), 2, 1)
    scores = np.zeros((2, 17))
    scores[:, 0] = 1.0
    assert len(match(rays, centers, scores, cameras, MAX_DISTANCE_M, CAP_M)) == 2
    scores[:, :5] = 1.0
    assert len(match(rays, centers, scores, cameras, MAX_DISTANCE_M, CAP_M)) == 1
