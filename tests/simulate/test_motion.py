"""Simulated people have bones, walk on the floor at human speeds, and keep out of each other."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import COCO17
from e3pose.simulate import SCENES, DetectorSettings, SceneSettings, simulate
from e3pose.simulate.body import Body, Posture, draw_body, joints_of

pytestmark = pytest.mark.slow

TORSO = {(5, 11), (6, 12)}  # not bones: the spine twists between shoulders and hips


@cache
def truth(scene: str, seed: int, seconds: float = 10.0) -> Floats:
    settings = SceneSettings(
        scene=scene, seconds=seconds, cameras=1, fps=25, detector=DetectorSettings(perfect=True)
    )
    recording = simulate(settings, seed)
    assert recording.truth is not None
    return recording.truth.joints_m


# Falls and the like have tests of their own: bodies do not walk there, and the floor stops knees.
WALKED = sorted(name for name, scene in SCENES.items() if not scene.habits.does)


def hips(joints_m: Floats) -> Floats:
    return np.asarray(joints_m[..., 11:13, :].mean(axis=-2))


def angle_deg(joints_m: Floats, a: int, b: int, c: int) -> Floats:
    u, v = joints_m[..., a, :] - joints_m[..., b, :], joints_m[..., c, :] - joints_m[..., b, :]
    cosine = (u * v).sum(-1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(v, axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


@each_case("scene", WALKED)
def test_bones_keep_their_lengths(scene: str) -> None:
    joints = truth(scene, 1)
    for a, b in COCO17.limbs:
        if (a, b) not in TORSO:
            length = np.linalg.norm(joints[:, :, a] - joints[:, :, b], axis=-1)
            assert (np.nanmax(length, axis=0) - np.nanmin(length, axis=0)).max() < 1e-9
    spine = np.linalg.norm(joints[:, :, 5:7].mean(axis=2) - hips(joints), axis=-1)
    assert (np.nanmax(spine, axis=0) - np.nanmin(spine, axis=0)).max() < 1e-9


def test_bones_differ_between_people_within_human_proportion() -> None:
    joints = truth("crowd", 1)
    thigh = np.nanmedian(np.linalg.norm(joints[:, :, 11] - joints[:, :, 13], axis=-1), axis=0)
    assert np.ptp(thigh) > 0.02
    assert thigh.min() > 0.34 and thigh.max() < 0.53


@each_case("scene", WALKED)
def test_feet_stay_near_the_floor_and_do_not_slide(scene: str) -> None:
    joints = truth(scene, 1)
    ankles = joints[:, :, 15:17]
    height = ankles[..., 2] - SCENES[scene].floor_m(hips(joints)[..., :2])[..., None]
    assert np.nanmin(height) > 0.05 and np.nanmax(height) < 0.30
    floor = np.nanmin(height, axis=0)
    down = height < floor + 0.001
    stays = down[1:] & down[:-1]
    moving = np.isfinite(height).all(axis=-1)
    assert stays.sum() > 0.3 * 2 * moving.sum()  # feet are down long enough for this to mean much
    speed = np.linalg.norm(np.diff(ankles[..., :2], axis=0), axis=-1) * 25
    assert np.percentile(speed[stays], 99) < 0.02
    # Somebody has a foot down nearly always: nobody flies.
    with np.errstate(invalid="ignore"):
        airborne = (height > (floor + 0.03)).all(axis=-1)[moving]
    assert airborne.mean() < 0.02


@each_case("scene", WALKED)
def test_speeds_are_human(scene: str) -> None:
    joints = truth(scene, 1)
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * 25
    assert np.nanmax(speed) < 6.0  # an ankle in swing
    assert np.nanmax(speed[:, :, :7]) < 3.0  # head and shoulders
    walking = np.linalg.norm(np.diff(hips(joints)[..., :2], axis=0), axis=-1) * 25
    assert np.nanmax(walking) < 2.1
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1) * 625
    assert np.nanpercentile(acceleration, 99.9) < 80


def test_people_walk_at_a_walking_pace() -> None:
    walking = (
        np.linalg.norm(np.diff(hips(truth("crossing", 1, 20.0))[..., :2], axis=0), axis=-1) * 25
    )
    assert 0.8 < np.nanpercentile(walking, 60) < 1.5


@each_case("scene", WALKED)
def test_joints_bend_as_joints_do(scene: str) -> None:
    joints = truth(scene, 1)
    for hip, knee, ankle in ((11, 13, 15), (12, 14, 16)):
        bend = angle_deg(joints, hip, knee, ankle)
        assert np.nanmin(bend) > 60 and np.nanmax(bend) <= 180
        # The knee lies before the line from hip to ankle, never behind it.
        left = joints[:, :, 11] - joints[:, :, 12]
        ahead = np.cross(left, [0.0, 0.0, 1.0])
        middle = (joints[:, :, hip] + joints[:, :, ankle]) / 2
        assert np.nanmin(((joints[:, :, knee] - middle) * ahead).sum(-1)) > -0.02
    for shoulder, elbow, wrist in ((5, 7, 9), (6, 8, 10)):
        assert np.nanmin(angle_deg(joints, shoulder, elbow, wrist)) > 25


def test_walking_knees_swing_and_arms_go_against_the_legs() -> None:
    joints = truth("crossing", 1, 20.0)
    knee = angle_deg(joints, 11, 13, 15)
    assert 95 < np.nanpercentile(knee, 1) < 130  # about 60 degrees of flexion in swing
    assert np.nanpercentile(knee, 99) > 165
    ahead = np.cross(joints[:, :, 11] - joints[:, :, 12], [0.0, 0.0, 1.0])
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    legs = ((joints[:, :, 15] - joints[:, :, 16]) * ahead).sum(-1).ravel()
    arms = ((joints[:, :, 9] - joints[:, :, 10]) * ahead).sum(-1).ravel()
    assert np.corrcoef(legs, arms)[0, 1] < -0.6


def test_people_sit_on_seats_and_get_up_again() -> None:
    joints = truth("meeting", 1, 60.0)
    height = hips(joints)[..., 2]
    seated = height < 0.6
    assert seated.any(axis=0).all() and (~seated & np.isfinite(height)).any(axis=0).all()
    knee = angle_deg(joints, 11, 13, 15)
    assert 70 < np.median(knee[seated]) < 115
    # Two people never share a seat.
    for slot in np.flatnonzero(seated.sum(axis=1) >= 2)[::25]:
        xy = hips(joints)[slot, seated[slot], :2]
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + 9 * np.eye(len(xy))
        assert apart.min() > 0.6


@each_case("scene", WALKED)
def test_nobody_walks_through_another(scene: str) -> None:
    xy = hips(truth(scene, 1))[..., :2]
    apart = np.linalg.norm(xy[:, :, None] - xy[:, None], axis=-1)
    apart[:, np.arange(xy.shape[1]), np.arange(xy.shape[1])] = np.inf
    assert np.nanmin(apart) > 0.44


def test_paths_cross_closely() -> None:
    xy = hips(truth("crossing", 1, 20.0))[..., :2]
    apart = np.linalg.norm(xy[:, :, None] - xy[:, None], axis=-1)
    near = (apart < 0.9) & (apart > 0)
    assert (np.diff(near.astype(int), axis=0) > 0).sum() / 2 > 10  # encounters in a minute


def test_nobody_walks_through_a_pillar() -> None:
    xy = hips(truth("pillar", 1, 20.0))[..., :2]
    for occluder in SCENES["pillar"].occluders:
        gap = np.linalg.norm(occluder.nearest(xy) - xy, axis=-1)
        assert np.nanmin(gap) > 0.12


def test_people_leave_and_come_back() -> None:
    known = np.isfinite(truth("ring", 1, 120.0))
    present = known.all(axis=(2, 3))
    assert (known.any(axis=(2, 3)) == present).all()
    changes = np.diff(present.astype(int), axis=0)
    assert (changes < 0).sum() >= 2 and (changes > 0).sum() >= 2
    assert present.mean() > 0.6


def straight(body: Body) -> Posture:
    """A body upright with straight arms and legs, looking along x."""
    hip = body.ankle_height + body.thigh + body.shank
    zero = np.zeros((1, 3))
    ankles = [[0.0, side * body.hip_half, body.ankle_height] for side in (1, -1)]
    return Posture(
        np.array([[0.0, 0.0, hip]]), zero, zero, zero, np.zeros(1), np.array([ankles]),
        np.zeros((1, 2, 4)),
    )  # fmt: skip


def test_upright_body_stands_where_its_bones_say() -> None:
    body = draw_body(np.random.default_rng(0))
    joints = joints_of(body, straight(body))[0]
    shoulder = body.ankle_height + body.thigh + body.shank + body.spine
    assert joints[5] == pytest.approx([0, body.shoulder_half, shoulder])
    assert joints[10] == pytest.approx(
        [0, -body.shoulder_half, shoulder - body.upper_arm - body.forearm]
    )
    assert joints[0, 0] > joints[1, 0] > joints[3, 0]  # nose before eyes before ears
    assert joints[1, 1] > joints[2, 1]  # x forward, y left
    assert 0.9 * body.stature < joints[0, 2] < body.stature
