"""Whole slots against known people, compiled and in plain numpy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case
from tests.rigs import on_circle, towards

from bench_fuse import load_workload, quality, run
from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.estimate.per_slot.fuse import MAX_POSES, Fuser, Fusion, FusionSettings
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D

NUM_JOINTS = 17
BODY = np.random.default_rng(7).uniform((-0.25, -0.25, 0.1), (0.25, 0.25, 1.7), (NUM_JOINTS, 3))


def ring(num_cameras: int, distortion: tuple[float, ...] = (), fisheye: bool = False) -> Rig:
    places = (on_circle(5.0, 2.5 + 0.1 * n, 2.4 * n + 0.2) for n in range(num_cameras))
    return Rig(tuple(
        towards(f"c{n}", place, focal=700, lens=distortion, fisheye=fisheye)
        for n, place in enumerate(places)
    ))  # fmt: skip


def people(num_persons: int) -> Floats:
    """`(num_persons, NUM_JOINTS, 3)`: equal bodies 1 m apart."""
    spots = [(np.cos(2.0 * i) * 0.7 * (i > 0), np.sin(2.0 * i) * i * 0.5, 0) for i in range(4)]
    return np.stack([BODY + spots[i] for i in range(num_persons)])


def views_of(rig: Rig, joints_m: Floats, score: float = 0.8) -> dict[int, Poses2D]:
    return {
        index: Poses2D(camera.project(joints_m), np.full(joints_m.shape[:2], score))
        for index, camera in enumerate(rig.cameras)
    }


def errors_m(fusion: Fusion, joints_m: Floats) -> Floats:
    """Distance of each true person to the nearest found one, the mean over their joints."""
    distance = np.linalg.norm(fusion.people.joints_m[:, None] - joints_m[None], axis=-1)
    return np.asarray(distance.mean(axis=-1).min(axis=0))


@each_case(
    ("distortion", "fisheye"),
    [
        ((), False),
        ((-0.2, 0.05, 0.001, -0.001), False),
        ((-0.2, 0.05, 0.001, -0.001, 0.01), False),
        ((0.1, 0.01, -0.002, 0.001), True),
    ],
)
def test_people_seen_without_noise_are_found_where_they_are(
    distortion: tuple[float, ...], fisheye: bool
) -> None:
    rig, truth = ring(4, distortion, fisheye), people(3)
    fusion = Fuser(rig, NUM_JOINTS).fuse(views_of(rig, truth))
    assert len(fusion.people) == 3
    assert errors_m(fusion, truth).max() < 1e-6
    assert np.allclose(fusion.people.scores, 0.8)
    assert fusion.reprojection_error_px.max() < 1e-3
    assert (np.sort(fusion.members, axis=0) == np.arange(3)[:, None]).all()
    assert (fusion.members == fusion.members[:, :1]).all()


def test_one_view_gives_nobody_and_views_of_nobody_change_nothing() -> None:
    rig, truth = ring(3), people(2)
    views = views_of(rig, truth)
    for some in ({}, {0: views[0]}, {i: Poses2D.empty(NUM_JOINTS) for i in range(3)}):
        fusion = Fuser(rig, NUM_JOINTS).fuse(some)
        assert fusion.people.joints_m.shape == (0, NUM_JOINTS, 3)
        assert fusion.members.shape == (0, 3)
        assert fusion.reprojection_error_px.shape == (0, NUM_JOINTS)
    one = views_of(rig, truth[:1])
    empty = one | {1: Poses2D.empty(NUM_JOINTS)}
    assert Fuser(rig, NUM_JOINTS).fuse(empty).members.tolist() == [[0, -1, 0]]
    alone = one | {2: views[2]}  # the second person is in one view only
    assert Fuser(rig, NUM_JOINTS).fuse(alone).members.tolist() == [[0, 0, 0]]


def test_joint_seen_once_is_nan_with_score_0() -> None:
    rig, truth = ring(3), people(1)
    views = views_of(rig, truth)
    keypoints = [views[i].keypoints_px.copy() for i in range(3)]
    keypoints[0][0, 4] = keypoints[1][0, 4] = np.nan
    keypoints[0][0, 5] = np.nan
    views = {i: Poses2D(keypoints[i], views[i].scores) for i in range(3)}
    fusion = Fuser(rig, NUM_JOINTS).fuse(views)
    assert np.isnan(fusion.people.joints_m[0, 4]).all()
    assert fusion.people.scores[0, 4] == 0
    assert np.isnan(fusion.reprojection_error_px[0, 4])
    assert np.linalg.norm(fusion.people.joints_m[0, 5] - truth[0, 5]) < 1e-6


def test_bad_numbers_count_as_missing() -> None:
    rig, truth = ring(3), people(1)
    keypoints = rig.project(truth)
    scores = np.full((3, 1, NUM_JOINTS), 0.5)
    for joint, value in enumerate((np.nan, np.inf, -np.inf, 1e300, -1e9)):
        keypoints[0, 0, joint] = value
    scores[0, 0, 5] = np.nan
    scores[0, 0, 6] = -1
    scores[1, 0, 7] = 2.0
    fusion = Fuser(rig, NUM_JOINTS).fuse_arrays(keypoints, scores, np.ones(3, int))
    assert errors_m(fusion, truth).max() < 1e-6
    assert np.isclose(fusion.people.scores[0, 7], 2 / 3)
    assert fusion.people.scores.max() <= 1


def test_rows_beyond_the_count_are_ignored() -> None:
    rig, truth = ring(3), people(2)
    keypoints, scores = rig.project(truth), np.ones((3, 2, NUM_JOINTS))
    fuser = Fuser(rig, NUM_JOINTS)
    assert len(fuser.fuse_arrays(keypoints, scores, np.array([2, 2, 2])).people) == 2
    # The second slot must not see what the first left in memory.
    fusion = fuser.fuse_arrays(keypoints, scores, np.array([2, 1, 1]))
    assert fusion.members.tolist() == [[0, 0, 0]]


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_order_of_cameras_and_people_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = ring(5)
    truth = people(3)
    views = {}
    for camera, view in views_of(rig, truth).items():
        noisy = view.keypoints_px + rng.normal(size=view.keypoints_px.shape) * 4
        scores = rng.uniform(0, 1, view.scores.shape)
        views[camera] = Poses2D(noisy, np.where(scores < 0.1, 0.0, scores))
    cameras = rng.permutation(5)
    rows = [rng.permutation(3) for _ in range(5)]
    mixed = {}
    for new, old in enumerate(cameras):
        view, row = views[int(old)], rows[new]
        mixed[new] = Poses2D(view.keypoints_px[row], view.scores[row])
    first = Fuser(rig, NUM_JOINTS).fuse(views)
    second = Fuser(rig.subset(cameras.tolist()), NUM_JOINTS).fuse(mixed)
    assert np.allclose(first.people.joints_m, second.people.joints_m, atol=1e-8, equal_nan=True)
    assert np.allclose(first.people.scores, second.people.scores)
    for new, old in enumerate(cameras):
        column = second.members[:, new]
        named = np.where(column < 0, -1, rows[new][column])
        assert (named == first.members[:, old]).all()


def test_person_split_in_one_view_is_found_once() -> None:
    rig, truth = ring(4), people(1)
    views = views_of(rig, truth)
    upper, lower = np.full((2, NUM_JOINTS), 0.8)
    upper[8:], lower[:8] = 0, 0
    for camera in (0, 1):
        keypoints = np.repeat(views[camera].keypoints_px, 2, axis=0)
        views[camera] = Poses2D(keypoints, np.stack([upper, lower]))
    fusion = Fuser(rig, NUM_JOINTS).fuse(views)
    assert len(fusion.people) == 1
    assert errors_m(fusion, truth).max() < 1e-6


def test_view_that_lies_is_outvoted_only_when_asked() -> None:
    rig, truth = ring(5), people(1)
    views = views_of(rig, truth)
    keypoints = views[3].keypoints_px.copy()
    keypoints[0, 2] += [60, 40]
    views[3] = Poses2D(keypoints, views[3].scores)
    plain = Fuser(rig, NUM_JOINTS).fuse(views)
    robust = Fuser(rig, NUM_JOINTS, FusionSettings(refine_steps=8, reject_outliers=True)).fuse(
        views
    )
    error, robust_error = (
        np.linalg.norm(f.people.joints_m[0, 2] - truth[0, 2]) for f in (plain, robust)
    )
    assert error > 0.03
    assert robust_error < 0.003
    assert robust.people.scores[0, 2] < 0.7 < robust.people.scores[0, 3]


@each_case(
    ("keypoints", "scores", "counts", "named"),
    [
        ((3, 1, 17, 2), (3, 1, 17), [1, 1], "shapes"),
        ((2, 1, 17, 2), (2, 1, 17), [1, 1], "shapes"),
        ((3, 1, 16, 2), (3, 1, 16), [1, 1, 1], "shapes"),
        ((3, 1, 17, 3), (3, 1, 17), [1, 1, 1], "shapes"),
        ((3, 1, 17, 2), (3, 1, 17), [1, 2, 1], "counts"),
        ((3, 1, 17, 2), (3, 1, 17), [1, -1, 1], "counts"),
        ((3, 2000, 17, 2), (3, 2000, 17), [2000, 2000, 2000], f"at most {MAX_POSES}"),
    ],
)
def test_wrong_arrays_get_one_line(
    keypoints: tuple[int, ...], scores: tuple[int, ...], counts: list[int], named: str
) -> None:
    fuser = Fuser(ring(3), 17)
    with pytest.raises(InputError, match=named) as caught:
        fuser.fuse_arrays(np.zeros(keypoints), np.zeros(scores), np.array(counts))
    assert "\n" not in str(caught.value)
    for camera, joints, message in ((3, 17, "camera 3"), (1, 25, "c1")):
        with pytest.raises(InputError, match=message):
            fuser.fuse({camera: Poses2D.empty(joints)})


@each_case(
    ("name", "value"),
    [
        ("max_distance_m", 0.0),
        ("cap_m", float("nan")),
        ("duplicate_m", -0.1),
        ("min_joints", 0),
        ("refine_steps", -1),
        ("matcher", "hungarian"),
        ("max_epipolar_px", 0.0),
        ("max_epipolar_px", float("nan")),
    ],
)
def test_wrong_settings_are_named(name: str, value: float | str) -> None:
    with pytest.raises(InputError, match=name):
        FusionSettings(**{name: value})  # type: ignore[arg-type]


def test_importing_loads_no_numba_until_something_is_fused() -> None:
    code = (
        "import sys, e3pose.estimate.per_slot.fuse as f, e3pose.model.camera as c, numpy as np\n"
        "rig = c.Rig((c.Camera('a', (10, 10), np.diag([9., 9., 1.]), np.eye(4)),))\n"
        "print('numba' in sys.modules)\n"
        "f.Fuser(rig, 17).warm_up()\n"
        "print('numba' in sys.modules)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == ["False", "True"]


@pytest.mark.shared
@pytest.mark.parity
@each_case(
    ("workload", "recall", "precision", "mpjpe_mm"),
    [("c5_k4", 0.99, 0.99, 8.7), ("c5_k8", 0.99, 0.99, 11.7), ("c5_k16", 0.985, 0.985, 18.1)]
    + [("c12_k8", 0.99, 0.99, np.inf), ("c28_k8", 0.99, 0.99, np.inf)],
)
def test_workloads_reach_the_best_known_quality(
    workload: str, recall: float, precision: float, mpjpe_mm: float
) -> None:
    folder = os.environ.get("E3POSE_SHARED")
    if not folder:
        pytest.skip("E3POSE_SHARED is not set")
    bench = load_workload(Path(folder) / "bench" / f"workload_{workload}.npz")
    found = quality(run(bench, FusionSettings()), bench.truth_m)
    assert found["recall"] >= recall
    assert found["precision"] >= precision
    assert found["mpjpe_mm"] <= mpjpe_mm
