"""Motion that is learned from: clips, bodies, smoothing, windows, simulated detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.reference.normalise import to_world

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import CMU31, COCO17
from e3pose.predict.normalise import NUM_COMMON
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.simulate import DetectorSettings
from e3pose_lab.train.bodies import (
    MIRRORED,
    ORDER,
    PARENT,
    mirrored,
    other_bodies,
    swapped_arms,
    uneven_time,
)
from e3pose_lab.train.clips import clips_of, gather
from e3pose_lab.train.smooth import smooth
from e3pose_lab.train.watched import as_coco17, watched
from e3pose_lab.train.windows import Clip, Corruption, Sampler, estimation_noise, spoil, usual_error

CLEAN = Corruption(exact=1.0, missing=0.0, short=0.0)


def gliding_clip(num_slots: int = 60, speed: float = 0.02, fps: float = 30.0) -> Clip:
    pose = np.random.default_rng(0).normal(size=(NUM_COMMON, 3)) * 0.3
    path = np.arange(num_slots)[:, None, None] * np.array([speed, 0, 0])
    return Clip("gliding", (pose + path).astype(np.float32), fps)


def test_windows_of_even_motion_go_on_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("e3pose_lab.train.windows.UNEVEN", 0.0)
    sampler = Sampler([gliding_clip()], 10, 15)
    windows = sampler.draw(np.random.default_rng(0), 200, CLEAN)
    assert windows.normal.features.shape == (10, 200, 7 * NUM_COMMON)
    assert windows.future_m.shape == (15, 200, NUM_COMMON, 3)
    world = to_world(windows.normal, windows.future_m)
    steps = np.diff(np.concatenate([windows.normal.newest_m[None], world]), axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:1], steps.shape), atol=1e-5)
    np.testing.assert_allclose(windows.usual_m, 0, atol=1e-4)  # constant velocity is right


def test_windows_never_leave_their_clip_and_are_the_same_for_a_seed() -> None:
    far = gliding_clip()
    sampler = Sampler([gliding_clip(), Clip("far", far.joints_m + 1000, 30.0)], 10, 15)
    first, second = (sampler.draw(np.random.default_rng(1), 500, Corruption()) for _ in range(2))
    assert np.abs(first.future_m).max() < 5
    np.testing.assert_array_equal(first.normal.features, second.normal.features)
    np.testing.assert_array_equal(first.future_m, second.future_m)
    short = Sampler([gliding_clip(26)], 10, 15).draw(np.random.default_rng(2), 100, CLEAN)
    assert np.isfinite(short.future_m).all(), "drawn at a rate that fits"


def test_noise_has_the_size_and_memory_asked_for() -> None:
    size = 4000
    level, interval = np.full(size, 0.03), np.full(size, 1 / 25)
    noise = estimation_noise(21, level, interval, np.random.default_rng(4))
    assert np.sqrt(np.square(noise).sum(axis=-1).mean()) == pytest.approx(0.03, rel=0.15)
    power = np.square(noise[0]).mean()
    kept = [float((noise[0] * noise[k]).mean() / power) for k in (1, 8, 20)]
    # Measured on detections: 0.77, 0.41 and 0.30; shares vary from window to window here.
    np.testing.assert_allclose(kept, [0.74, 0.40, 0.32], atol=0.08)


def test_every_window_keeps_something_and_all_without_noise() -> None:
    history = np.zeros((10, 3000, NUM_COMMON, 3))
    worst = Corruption(exact=0.0, missing=1.0, short=1.0)
    spoilt = spoil(history, np.full(3000, 0.04), np.random.default_rng(7), worst)
    assert np.isfinite(spoilt).any(axis=(0, 2, 3)).all()
    assert 0.1 < np.isnan(spoilt[-1]).mean() < 0.5
    history = np.random.default_rng(5).normal(size=(10, 7, NUM_COMMON, 3))
    exact = spoil(history, np.full(7, 0.04), np.random.default_rng(6), CLEAN)
    np.testing.assert_array_equal(exact, history)


def test_usual_error_is_that_of_the_best_simple_predictor() -> None:
    slot = np.arange(13)[:, None, None, None]
    still = np.zeros((13, 1, NUM_COMMON, 3))
    moving = still + slot * [0.1, 0, 0]
    jumps = still.copy()
    jumps[10:, ..., 0] = 0.5
    joints = np.concatenate([still, moving, jumps], axis=1)
    error = usual_error(joints[:10], joints[10:])
    np.testing.assert_allclose(error, [[0, 0, 0.5]] * 3, atol=1e-12)


def recording(name: str, joints_m: Floats | None) -> Recording:
    rig = ring_rig(2, 4.0, 2.0, (640, 480), np.random.default_rng(0))
    slots = 100 if joints_m is None else len(joints_m)
    people = 0 if joints_m is None else joints_m.shape[1]
    names = tuple(f"p{k}" for k in range(people))
    truth = None if joints_m is None else Truth(COCO17, names, joints_m)
    views = (ViewSeries.from_views([], [], [], 17),) * 2
    return Recording(name, rig, 10.0, slots, COCO17, views, truth)


def numbered(slots: int, people: int = 1) -> Floats:
    """Return people whose every coordinate is the slot, so that a clip tells where it is from."""
    return np.arange(slots, dtype=float)[:, None, None, None] * np.ones((1, people, 17, 3))


def test_a_clip_ends_where_a_joint_is_unknown() -> None:
    joints = numbered(100, people=2)
    joints[40, 0, 9] = np.nan  # a wrist
    joints[70:75, 1] = np.nan
    joints[10, 1, 1] = np.nan  # an eye, which the network does not look at
    clips = clips_of(recording("a", joints), shortest=25)
    assert [len(c.joints_m) for c in clips] == [40, 59, 70, 25]


def test_the_end_of_long_motion_is_held_out_a_window_apart() -> None:
    training, groups = gather([recording("a", numbered(1000))], [], 0.2, 25)
    assert [name for name, _ in groups] == ["a, the end"]
    assert training[0].joints_m.max() == 774
    assert groups[0][1][0].joints_m.min() == 800


def test_whole_recordings_are_held_out_by_kind() -> None:
    ring = [recording(f"ring {number}", numbered(100)) for number in (1, 2, 3)]
    training, groups = gather(ring[:1], ring[1:], 0.2, 25)
    assert len(training) == 1
    assert [(name, len(clips)) for name, clips in groups] == [("ring", 2)]


def test_nothing_is_both_learned_and_validated() -> None:
    one = recording("a", numbered(100))
    with pytest.raises(InputError, match="a: found to learn from and to validate"):
        gather([one], [one], 0.2, 25)


@pytest.mark.parametrize(
    ("learned", "held_out", "said"),
    [
        (recording("a", numbered(100)), None, "validate"),
        (recording("a", numbered(10)), recording("b", numbered(100)), "learn"),
        (recording("a", None), recording("b", numbered(100)), "truth"),
    ],
)
def test_too_little_motion_is_said(
    learned: Recording, held_out: Recording | None, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        gather([learned], [held_out] if held_out else [], 0.2, 25)


def test_simulated_people_are_drawn_less_than_real_ones() -> None:
    learned = [recording("real", numbered(100)), recording("simulated ring", numbered(900))]
    clips, _ = gather(learned, [recording("b", numbered(100))], 0.0, 25)
    seconds = {c.name.split(",")[0]: c.weight * len(c.joints_m) for c in clips}
    share = seconds["simulated ring"] / sum(seconds.values())
    assert share == pytest.approx(0.2)


def motion(size: int = 200, num_slots: int = 6, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(1, size, NUM_COMMON, 3)) * 0.3
    return pose + np.cumsum(rng.normal(0, 0.02, (num_slots, size, NUM_COMMON, 3)), axis=0)


def test_mirroring_twice_is_nothing() -> None:
    assert [MIRRORED[i] for i in MIRRORED] == list(range(NUM_COMMON))
    once = motion()
    which = np.arange(200) % 2 == 0
    mirrored(once, which)
    np.testing.assert_array_equal(once[:, ~which], motion()[:, ~which])
    np.testing.assert_allclose(once[:, which, 2, 0], -motion()[:, which, 3, 0])
    mirrored(once, which)
    np.testing.assert_array_equal(once, motion())


def test_every_joint_hangs_on_one_that_comes_before_it() -> None:
    assert sorted(ORDER) == list(range(NUM_COMMON))
    for place, joint in enumerate(ORDER):
        assert PARENT[joint] in (-1, *ORDER[:place])


def test_limbs_change_alike_on_both_sides_and_in_all_slots() -> None:
    before = motion()
    after = other_bodies(before, np.random.default_rng(1))
    for left, right in ((2, 3), (8, 9)):  # knees on hips, elbows on shoulders
        ratios = []
        for joint in (left, right):
            parent = PARENT[joint]
            old = np.linalg.norm(before[:, :, joint] - before[:, :, parent], axis=-1)
            new = np.linalg.norm(after[:, :, joint] - after[:, :, parent], axis=-1)
            ratios.append(new / old)
        long = np.linalg.norm(before[:, :, left] - before[:, :, PARENT[left]], axis=-1) > 0.3
        assert np.std(np.log(np.array(ratios)[:, long])) < 0.12
        np.testing.assert_allclose(ratios[0][0][long[0]], ratios[0][-1][long[0]], rtol=0.1)


def test_swapped_arms_keep_shoulders_and_lengths() -> None:
    before = motion()
    after = swapped_arms(before, 1.0, np.random.default_rng(2))
    others = [joint for joint in range(NUM_COMMON) if joint not in (8, 9, 10, 11)]
    np.testing.assert_array_equal(after[:, :, others], before[:, :, others])
    lengths = np.linalg.norm(before[:, :, 8] - before[:, :, 6], axis=-1)
    swapped = np.linalg.norm(after[:, :, 8] - after[:, :, 6], axis=-1)
    apart = np.abs(swapped[:, :, None] - lengths[:, None]).max(axis=0).min(axis=1)
    np.testing.assert_allclose(apart, 0, atol=1e-9)  # whole arms, over time, of somebody
    assert (np.abs(swapped - lengths).max(axis=0) > 1e-3).mean() > 0.9  # and of somebody else
    np.testing.assert_array_equal(swapped_arms(before, 0.0, np.random.default_rng(2)), before)


def test_time_passes_unevenly_but_forwards_and_to_the_end() -> None:
    slots = uneven_time(25, 500, 0.3, np.random.default_rng(3))
    np.testing.assert_allclose(slots[:, [0, -1]], [[0, 24]] * 500, atol=1e-9)
    steps = np.diff(slots, axis=1)
    assert steps.min() > 0.4 and steps.max() < 1.8 and steps.std() > 0.03
    even = uneven_time(25, 3, 0.0, np.random.default_rng(3))
    np.testing.assert_allclose(even, np.arange(25)[None].repeat(3, axis=0), atol=1e-9)


DT = 1 / 25


def parabola(slots: int = 40) -> Floats:
    t = np.arange(slots)[:, None, None] * DT
    return np.asarray(
        np.array([1.0, -2.0, 0.5]) * t**2 + np.array([0.3, 0, 1]) * t + np.ones((1, 2, 3))
    )


def test_a_parabola_stays_as_it_is_and_noise_becomes_less() -> None:
    np.testing.assert_allclose(smooth(parabola(), DT), parabola(), atol=1e-9)
    noise = np.random.default_rng(0).normal(0, 0.02, (400, 5, 3))
    assert smooth(noise, DT)[5:-5].std() < 0.75 * 0.02


@pytest.mark.parametrize(("hertz", "least"), [(1.0, 0.99), (2.0, 0.97), (4.0, 0.7)])
def test_human_motion_passes(hertz: float, least: float) -> None:
    t = np.arange(200)[:, None, None] * DT
    wave = 0.05 * np.sin(2 * np.pi * hertz * t) * np.ones((1, 1, 3))
    kept = smooth(wave, DT)[20:-20]
    assert kept.std() / wave[20:-20].std() > least


def test_an_outlier_counts_less() -> None:
    joints = parabola()
    joints[20, 0] += 0.5
    off = np.abs(smooth(joints, DT) - parabola())
    assert off.max() < 0.25 * 0.5
    np.testing.assert_allclose(off[:, 1], 0, atol=1e-9)


def test_short_gaps_are_closed_and_long_ones_stay() -> None:
    joints = parabola()
    joints[10:12, 0] = np.nan
    joints[20:35, 1] = np.nan
    result = smooth(joints, DT)
    np.testing.assert_allclose(result[:, 0], parabola()[:, 0], atol=1e-9)
    assert np.isnan(result[22:33, 1]).all()
    assert np.isnan(smooth(joints[11:12], DT)[:, 0]).all()
    joints[:5] = joints[-5:] = np.nan  # nothing is made up before and after
    result = smooth(joints, DT)
    assert np.isnan(result[:5]).all() and np.isnan(result[-5:]).all()


def test_few_slots_a_second_are_left_alone() -> None:
    joints = np.random.default_rng(0).normal(size=(10, 3, 3))
    lacking = joints.copy()
    lacking[4, 0] = lacking[7:, 1] = np.nan
    wanted = lacking.copy()
    wanted[4, 0] = (joints[3, 0] + joints[5, 0]) / 2
    np.testing.assert_array_equal(smooth(lacking, 0.2), wanted)


def standing() -> Floats:
    """Return `(1, 1, 31, 3)`: somebody who stands upright and looks along x."""
    joints = np.random.default_rng(0).normal(0, 0.1, (1, 1, len(CMU31), 3)) + [0.0, 0.0, 1.0]
    for name, place in (
        ("upper_neck", (0.0, 0.0, 1.5)),
        ("top_head", (0.0, 0.0, 1.7)),
        ("left_shoulder", (0.0, 0.2, 1.4)),
        ("right_shoulder", (0.0, -0.2, 1.4)),
    ):
        joints[..., CMU31.index(name), :] = place
    return joints


def captured(joints_m: Floats) -> Recording:
    rig = ring_rig(3, 4.0, 2.0, (640, 480), np.random.default_rng(0))
    nothing = ViewSeries.from_views([], [], [], len(CMU31))
    truth = Truth(CMU31, ("somebody",), joints_m)
    return Recording("m", rig, 10.0, len(joints_m), CMU31, (nothing,) * 3, truth=truth)


def test_heads_of_motion_capture_are_given_a_face() -> None:
    face = as_coco17(standing())[0, 0]
    nose, left_ear, right_ear = (
        face[COCO17.index(name)] for name in ("nose", "left_ear", "right_ear")
    )
    np.testing.assert_allclose(nose, [0.09, 0.0, 1.6], atol=1e-9)
    np.testing.assert_allclose(left_ear - right_ear, [0.0, 0.15, 0.0], atol=1e-9)


def test_joints_are_seen_where_they_project() -> None:
    moving = np.repeat(standing(), 5, axis=0)
    seen = watched(captured(moving), 0, detector=DetectorSettings(perfect=True))
    assert seen.truth is not None and seen.skeleton == seen.truth.skeleton == COCO17
    for number, camera in enumerate(seen.rig.cameras):
        view = seen.view(3, number)
        assert view is not None
        expected = camera.project(seen.truth.joints_m[3, 0])
        np.testing.assert_allclose(view.keypoints_px[0], expected, atol=1e-3)
    with pytest.raises(InputError, match="truth: found none"):
        watched(replace(captured(standing()), truth=None), 0)


def test_without_truth_there_is_nobody_to_see() -> None:
    with pytest.raises(InputError, match="truth: found none"):
        watched(replace(captured(standing()), truth=None), 0)
