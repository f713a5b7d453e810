"""The compiled fuser against its numpy reference, and the compiled assignment against scipy's."""

from __future__ import annotations

import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from tests.cases import each_case
from tests.interpreted import interpreted
from tests.reference.fuse import ReferenceFuser
from tests.rigs import on_circle, towards

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.assign import assign
from e3pose.estimate.per_slot.fuse import Fuser, Fusion, FusionSettings
from e3pose.estimate.per_slot.triangulate import null_vector
from e3pose.model.camera import Camera, Rig

pytestmark = pytest.mark.slow

Slot = tuple[Floats, Floats, NDArray[np.int64]]

NUM_RIGS = {"without distortion": 24, "with any lenses": 60}
AGREE_M = 1e-6
REACH_M = 100.0  # a joint further away than this is an accident of nearly parallel rays


def random_lens(rng: np.random.Generator) -> tuple[Floats, bool]:
    """Every model, from mild to so wild that it folds within the image."""
    length = int(rng.choice([0, 4, 4, 5, 5, 8, 8]))
    fisheye = length == 4 and bool(rng.random() < 0.5)
    usual = (0.1, 0.05, 0.02, 0.01) if fisheye else (0.3, 0.1, 0.002, 0.002, 0.05, 0.3, 0.1, 0.05)
    return rng.normal(size=length) * usual[:length] * rng.choice([0.3, 1, 1, 3]), fisheye


def random_rig(rng: np.random.Generator, distorted: bool) -> Rig:
    cameras = []
    for index in range(rng.integers(1, 9)):
        center = rng.normal(size=3) * rng.uniform(1, 5) + (0, 0, 1.5)
        forward = rng.normal(size=3) * 0.7 - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, rng.normal(size=3))
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        f = rng.uniform(400, 1500)
        K = np.array([[f, rng.normal(), 500], [0, f * rng.uniform(0.9, 1.1), 400], [0, 0, 1]])
        lens, fisheye = random_lens(rng) if distorted else (np.zeros(0), False)
        camera = Camera.from_world_to_camera(
            f"c{index}", (1000, 800), K, R, -R @ center, lens, fisheye
        )
        cameras.append(camera)
    return Rig(tuple(cameras))


def random_slot(rng: np.random.Generator, rig: Rig, num_joints: int) -> Slot:
    """People in a crowd, some unseen by some views; noise, ghosts, missing and broken numbers."""
    num_persons = int(rng.integers(0, 6))
    spots = rng.normal(size=(num_persons, 1, 3)) * 1.5
    joints = spots + rng.normal(size=(num_persons, num_joints, 3)) * 0.4
    pixels = rig.project(joints)
    pixels += rng.normal(size=pixels.shape) * rng.choice([0, 1, 5, 30])
    shape = (len(rig), num_persons + 2, num_joints)
    keypoints = rng.uniform(0, 1000, (*shape, 2))
    counts = np.zeros(len(rig), np.int64)
    for camera in range(len(rig)):
        seen = rng.permutation(num_persons)[: rng.integers(0, num_persons + 1)]
        if rng.random() < 0.7:
            seen = rng.permutation(num_persons)
        keypoints[camera, : len(seen)] = pixels[camera, seen]
        counts[camera] = len(seen) + rng.integers(0, 3)
    keypoints[rng.random(shape) < 0.05] = np.nan
    scores = rng.uniform(0, 1, shape)
    scores[rng.random(shape) < 0.1] = 0
    scores[rng.random(shape) < 0.01] = np.nan
    return keypoints, scores, counts


def assert_agree(first: Fusion, second: Fusion) -> None:
    assert np.array_equal(first.members, second.members)
    a, b = first.people.joints_m, second.people.joints_m
    assert np.array_equal(np.isnan(a), np.isnan(b))
    near = np.abs(a) < REACH_M
    assert np.abs(a - b)[near].max(initial=0) < AGREE_M
    assert np.abs(first.people.scores - second.people.scores).max(initial=0) < AGREE_M


@pytest.mark.parametrize("kind", NUM_RIGS)
def test_kernels_equal_the_reference_on_random_rigs(kind: str) -> None:
    found = 0
    for seed in range(NUM_RIGS[kind]):
        rng = np.random.default_rng([seed, len(kind)])
        rig = random_rig(rng, distorted=kind == "with any lenses")
        num_joints = int(rng.choice([5, 14, 17, 25]))
        options = FusionSettings(
            refine_steps=int(rng.integers(0, 4)),
            reject_outliers=bool(rng.random() < 0.5),
        )
        arrays = random_slot(rng, rig, num_joints)
        fast = Fuser(rig, num_joints, options).fuse_arrays(*arrays)
        plain = ReferenceFuser(rig, num_joints, options).fuse_arrays(*arrays)
        assert_agree(fast, plain)
        present = np.isfinite(fast.people.joints_m).all(axis=-1)
        assert np.array_equal(present, fast.people.scores > 0)
        assert fast.people.scores.max(initial=0) <= 1
        error, plain_error = fast.reprojection_error_px, plain.reprojection_error_px
        assert np.allclose(error, plain_error, rtol=1e-4, atol=1e-4, equal_nan=True)
        found += len(fast.people)
    assert found > NUM_RIGS[kind] / 2  # the comparison is of something


def crowd(num_cameras: int, num_persons: int) -> tuple[Rig, Slot]:
    """Equal bodies on a grid in a ring of cameras: every view holds chance matches."""
    rng = np.random.default_rng([num_cameras, num_persons])
    angles = np.linspace(0, 2 * np.pi, num_cameras, endpoint=False)
    places = [on_circle(6.0, rng.uniform(2.0, 2.8), angle) for angle in angles]
    rig = Rig(tuple(
        towards(f"c{n}", place, (0, 0, 0.9), (1032, 776), 1050) for n, place in enumerate(places)
    ))  # fmt: skip
    body = rng.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 1.7), (17, 3))
    spots = np.stack(np.meshgrid(np.arange(4), np.arange(4), [0.0]), axis=-1).reshape(-1, 3)
    joints = body[None] + (spots[rng.permutation(16)[:num_persons], None] - (1.5, 1.5, 0)) * 0.8
    joints += rng.uniform((-0.15, -0.15, 0), (0.15, 0.15, 0), (num_persons, 1, 3))
    hidden = rng.random((num_cameras, num_persons, 17)) < 0.1
    scores = np.where(hidden, 0.2, 0.9)
    keypoints = rig.project(joints)
    keypoints += rng.normal(size=keypoints.shape) * np.where(hidden, 15.0, 2.0)[..., None]
    return rig, (keypoints, scores, np.full(num_cameras, num_persons))


@each_case(("num_cameras", "num_persons"), [(5, 16), (12, 8), (28, 4)])
def test_crowds_are_not_split(num_cameras: int, num_persons: int) -> None:
    rig, arrays = crowd(num_cameras, num_persons)
    fast = Fuser(rig, 17).fuse_arrays(*arrays)
    assert len(fast.people) == num_persons
    assert (np.sort(fast.members, axis=0) == np.arange(num_persons)[:, None]).all()
    assert (fast.members == fast.members[:, :1]).all()
    assert_agree(fast, ReferenceFuser(rig, 17).fuse_arrays(*arrays))


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), smallest=st.sampled_from([0.0, 1e-9, 1e-3, 0.5, 0.95]))
def test_null_vector_is_the_smallest_eigenvector(seed: int, smallest: float) -> None:
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    matrix = basis @ np.diag([smallest, *rng.uniform(1, 5, 3)]) @ basis.T
    out = np.zeros(4)
    interpreted(null_vector)(np.triu(matrix), np.zeros((2, 4, 4)), out)
    out /= np.linalg.norm(out)
    assert abs(abs(out @ basis[:, 0]) - 1) < 1e-12


def test_memory_grows_with_the_slot_and_holds_no_past_nor_is_a_result_overwritten() -> None:
    rig, (keypoints, scores, counts) = crowd(5, 16)
    fuser = Fuser(rig, 17)
    few = np.full(5, 2)
    before = fuser.fuse_arrays(keypoints, scores, few)
    joints_m = before.people.joints_m.copy()
    assert len(fuser.fuse_arrays(keypoints, scores, counts).people) == 16
    assert np.array_equal(before.people.joints_m, joints_m, equal_nan=True)
    after = fuser.fuse_arrays(keypoints, scores, few)
    assert np.array_equal(before.members, after.members)
    assert np.array_equal(joints_m, after.people.joints_m, equal_nan=True)


def test_fusers_of_several_threads_do_not_disturb_each_other() -> None:
    rig, arrays = crowd(5, 8)
    expected = Fuser(rig, 17).fuse_arrays(*arrays).people.joints_m
    wrong: list[Any] = []

    def work() -> None:
        fuser = Fuser(rig, 17)
        for _ in range(30):
            if not np.array_equal(fuser.fuse_arrays(*arrays).people.joints_m, expected):
                wrong.append(1)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_kernels_compile_where_nothing_can_be_written() -> None:
    code = (
        "import numba, numba.core.caching as c\n"
        "def refuse(*a, **k): raise RuntimeError('cannot cache function')\n"
        "c.FunctionCache.__init__ = refuse\n"
        "from e3pose.estimate.per_slot.triangulate import noise_px\n"
        "print(noise_px(0.2))\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.split() == ["15.0"], result.stderr


ROOM = 9  # rows and columns of the table that the costs are a corner of


def assigned(costs: Floats) -> list[int]:
    """Return the column of each row, -1 for none; what lies outside the costs is poison."""
    num_rows, num_columns = costs.shape
    table = np.full((ROOM, ROOM), np.nan)
    table[:num_rows, :num_columns] = costs
    integers = np.full((5, ROOM), -7, np.int64)
    more = np.zeros((3, ROOM)), integers, np.ones((2, ROOM), bool)
    interpreted(assign)(table, num_rows, num_columns, *more)
    return [int(column) for column in integers[0, :num_rows]]


def expected(costs: Floats) -> list[int]:
    columns = [-1] * len(costs)
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        columns[row] = int(column)
    return columns


sizes = st.integers(1, ROOM)


@settings(max_examples=80)
@given(
    rows=sizes, columns=sizes, seed=st.integers(0, 2**32 - 1), gate=st.sampled_from([0.2, 0.6, 9])
)
def test_assigns_as_scipy_does(rows: int, columns: int, seed: int, gate: float) -> None:
    costs = np.random.default_rng(seed).uniform(size=(rows, columns))
    costs[costs > gate] = 1e3
    assert assigned(costs) == expected(costs)


@settings(max_examples=80)
@given(rows=sizes, columns=sizes, seed=st.integers(0, 2**32 - 1))
def test_equal_costs_still_give_the_least_total(rows: int, columns: int, seed: int) -> None:
    costs = np.random.default_rng(seed).integers(0, 3, (rows, columns)).astype(np.float64)
    found = [(row, column) for row, column in enumerate(assigned(costs)) if column >= 0]
    assert len(found) == len({column for _, column in found}) == min(rows, columns)
    best = costs[linear_sum_assignment(costs)].sum()
    assert sum(costs[pair] for pair in found) == best


@each_case(
    ("costs", "columns"),
    [
        ([[0.5]], [0]),
        ([[1.0, 2.0], [1.0, 9.0]], [1, 0]),  # the first row gives way, though its choice is better
        ([[1.0], [0.0]], [-1, 0]),
        ([[3.0, 0.0, 3.0]], [1]),
    ],
)
def test_named_cases(costs: list[list[float]], columns: list[int]) -> None:
    assert assigned(np.array(costs)) == columns
