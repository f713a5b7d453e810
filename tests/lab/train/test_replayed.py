"""Histories as the filter makes them of true motion: whose they are, and how windows keep them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.predict.normalise import NUM_COMMON
from e3pose.recording import Recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose_lab.train.clips import gather
from e3pose_lab.train.replayed import ReplayedSettings
from e3pose_lab.train.training_clips import ClipSettings, training_clips
from e3pose_lab.train.windows import Clip, Corruption, Sampler, between_frames
from e3pose_lab.workers import Workers

pytestmark = pytest.mark.slow

SPAN = 20
TWICE = ClipSettings(target="truth", replayed=ReplayedSettings(replays=2))


@pytest.fixture(scope="module")
def room() -> Recording:
    detector = DetectorSettings(perfect=True)
    settings = SceneSettings(people=2, seconds=4.0, fps=20.0, cameras=3, detector=detector)
    return simulate(settings, seed=705)


@pytest.fixture(scope="module")
def clips(room: Recording) -> list[Clip]:
    return training_clips(room, SPAN, TWICE, Workers())


def test_replays_come_beside_the_truth_and_are_off_as_a_filter_is(clips: list[Clip]) -> None:
    replayed = [clip for clip in clips if clip.replayed]
    assert 2 <= len(replayed) < len(clips)
    assert len({clip.fps for clip in replayed}) == 2  # every replay has its own rate
    for clip in replayed:
        assert clip.errors_m is not None and clip.errors_m.shape[1] == 1
        off = np.linalg.norm(clip.errors_m[5:, 0].astype(np.float64), axis=-1)
        assert 0.003 < np.nanmean(off) < 0.15


def test_a_replay_is_the_same_whenever_it_is_made(room: Recording, clips: list[Clip]) -> None:
    again = training_clips(room, SPAN, TWICE, Workers())
    for one, other in zip(clips, again, strict=True):
        np.testing.assert_array_equal(one.joints_m, other.joints_m)
        if one.replayed:
            np.testing.assert_array_equal(one.errors_m, other.errors_m)


def test_scored_slots_are_not_learned_from(room: Recording) -> None:
    half = replace(room, scored_slots=(room.num_slots // 2, room.num_slots))
    clips = [clip for clip in training_clips(half, SPAN, TWICE, Workers()) if clip.replayed]
    assert clips
    for clip in clips:
        assert len(clip.joints_m) / clip.fps < 0.5 * 4.0 * np.exp(0.2) + 0.1


def test_one_camera_is_too_few(room: Recording) -> None:
    alone = replace(room, rig=Rig(room.rig.cameras[:1]), views=room.views[:1])
    with pytest.raises(InputError, match="cameras: found 1, expected 2 or more"):
        training_clips(alone, SPAN, TWICE, Workers())


def test_half_of_the_windows_are_replayed(room: Recording) -> None:
    held_out = replace(room, name="held out")
    clips, groups = gather(
        [room], [held_out], 0.0, SPAN, lambda r, n: training_clips(r, n, TWICE, Workers())
    )
    drawn = [clip.weight * len(clip.joints_m) for clip in clips]
    replays = [d for d, clip in zip(drawn, clips, strict=True) if clip.replayed]
    assert sum(replays) == pytest.approx(0.5 * sum(drawn))
    assert any(clip.replayed for _, some in groups for clip in some)


def test_windows_of_a_replay_keep_its_slots_and_errors() -> None:
    pose = np.random.default_rng(0).normal(size=(NUM_COMMON, 3)) * 0.3
    slots = np.arange(60.0)
    joints = pose + slots[:, None, None] * np.array([0.02, 0, 0])
    errors = np.zeros((60, 1, NUM_COMMON, 3), np.float16)
    errors[::2] = 0.125  # up and down, slot by slot
    clip = Clip("replay", joints.astype(np.float32), 20.0, errors_m=errors, replayed=True)
    clean = Corruption(exact=1.0, missing=0.0, short=0.0)
    rng = np.random.default_rng(0)
    true, given, interval = Sampler([clip], 10, 5).motion(rng, 30, clean)
    np.testing.assert_allclose(interval, 1 / 20.0)
    off = np.linalg.norm(given - true[:10], axis=-1).mean(axis=-1)  # (slots, windows)
    np.testing.assert_allclose(np.sort(off[:2], axis=0), [[0.0] * 30, [0.2165] * 30], atol=1e-3)
    np.testing.assert_allclose(off[:-2], off[2:], atol=1e-3)


def test_between_frames_follows_a_curve_and_knows_gaps() -> None:
    frames = np.arange(8.0)
    motion = np.repeat((frames**2)[:, None, None], 3, axis=2)
    motion[7] = np.nan
    at = np.array([1.0, 2.5, 3.25, 6.5])
    found = between_frames(motion, at)[:, 0, 0]
    np.testing.assert_allclose(found[:3], at[:3] ** 2, atol=1e-9)
    assert np.isnan(found[3])
