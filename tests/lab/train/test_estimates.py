"""Motion from detections: who teaches, what is drawn, and which slots nobody learns from."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import comb

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.lab.train.test_windows import gliding_clip

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.predict.normalise import NUM_COMMON, common_columns
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose_lab.prediction.normalise import to_common
from e3pose_lab.train.clips import gather, hold_out_ends
from e3pose_lab.train.estimates import (
    EstimateSettings,
    camera_combinations,
    clearly_seen,
    estimated_clips,
    follow,
    least_occluded,
)
from e3pose_lab.train.training_clips import ClipSettings, Target, free_stretches, training_clips
from e3pose_lab.train.windows import Clip, Corruption, Sampler, Variety
from e3pose_lab.workers import Workers

REFERENCE = EstimateSettings()
ALONE = Workers()


def scene(seconds: float = 2.0, cameras: int = 4, exact: bool = False) -> Recording:
    detector = DetectorSettings(perfect=exact)
    settings = SceneSettings(
        people=2, seconds=seconds, fps=20.0, cameras=cameras, detector=detector
    )
    return simulate(settings, seed=5)


@cache
def noisy() -> Recording:
    return scene()


@cache
def clips() -> list[Clip]:
    """What is estimated of all of it, without a look at the truth."""
    blind = replace(noisy(), truth=None)
    return estimated_clips(blind, 15, [(0, blind.num_slots)], REFERENCE, ALONE)


def distances_to_truth(recording: Recording, clip: Clip) -> Floats:
    """Return `(num_slots,)` mean distance to whoever of the truth is nearest, at any start."""
    assert recording.truth is not None
    truth = to_common(recording.truth.joints_m, common_columns(recording.truth.skeleton))
    best = np.full(len(clip.joints_m), np.inf)
    for start in range(recording.num_slots - len(clip.joints_m) + 1):
        part = truth[start : start + len(clip.joints_m)]
        apart = np.linalg.norm(part - clip.joints_m[:, None], axis=-1).mean(axis=-1)
        for person in np.nan_to_num(apart, nan=np.inf).T:
            if person.mean() < best.mean():
                best = person
    return best


def test_the_target_is_near_the_truth_that_was_never_looked_at() -> None:
    assert len(clips()) >= 2
    assert sum(len(c.joints_m) for c in clips()) > 40  # of 80 that two people could have
    errors = np.concatenate([distances_to_truth(noisy(), clip) for clip in clips()])
    assert errors.mean() < 0.025  # OpenPose-like detections in four views


def test_exact_detections_give_estimates_without_error() -> None:
    exact = scene(exact=True)
    (clip, *_) = estimated_clips(exact, 15, [(0, exact.num_slots)], REFERENCE, ALONE)
    assert clip.errors_m is not None
    # The target is smoothed, so that fast limbs differ a little from what the cameras see.
    assert np.nanpercentile(np.abs(clip.errors_m), 95) < 0.01


def test_estimates_differ_from_combination_to_combination() -> None:
    errors = clips()[0].errors_m
    assert errors is not None and errors.shape[1:] == (11, NUM_COMMON, 3)  # 6 + 4 + 1 of 4 cameras
    by_joint = np.moveaxis(errors, 1, -1).reshape(-1, 11).astype(np.float64)
    known = by_joint[np.isfinite(by_joint).all(axis=1)]
    assert len(known) > 100
    assert np.median(known.std(axis=1)) > 0.002


@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_few_cameras_are_combined_in_all_ways(cameras: int) -> None:
    found = camera_combinations(cameras, 32, None)
    assert len(set(found)) == len(found) == sum(comb(cameras, n) for n in range(2, cameras + 1))
    assert all(len(chosen) >= 2 for chosen in found)


def test_many_cameras_are_sampled_with_a_seed() -> None:
    first, again, other = (
        camera_combinations(20, 32, np.random.default_rng(seed)) for seed in (0, 0, 1)
    )
    assert first == again != other
    assert len(first) == 32
    assert all(2 <= len(c) <= 20 and len(set(c)) == len(c) and max(c) < 20 for c in first)
    assert min(map(len, first)) <= 4  # few cameras, which the system likes to wake, are seen too


def test_the_result_does_not_depend_on_who_works() -> None:
    settings = replace(REFERENCE, combinations=4)  # drawn at random
    alone, together = (
        estimated_clips(noisy(), 15, [(0, noisy().num_slots)], settings, Workers(jobs))
        for jobs in (1, 2)
    )
    assert len(alone) == len(together) > 0
    for one, two in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.joints_m, two.joints_m)
        assert one.errors_m is not None and two.errors_m is not None
        np.testing.assert_array_equal(one.errors_m, two.errors_m)


def test_the_least_occluded_cameras_are_those_whose_boxes_overlap_least() -> None:
    recording = noisy()
    pose = np.random.default_rng(2).uniform(100, 200, (17, 2))
    apart_px = (500.0, 20.0, 90.0)  # of two people in the views of three cameras
    views = {
        camera: Poses2D(np.stack([pose, pose + [apart, 0]]), np.ones((2, 17)))
        for camera, apart in enumerate(apart_px)
    }
    views[3] = Poses2D.empty(17)  # sees nobody, so that nobody hides anybody
    assert list(least_occluded(recording.rig, views, 2)) == [0, 2]
    assert list(least_occluded(recording.rig, views, 9)) == [0, 2, 1]


def test_live_targets_are_what_the_least_occluded_cameras_see() -> None:
    exact = scene(exact=True)
    people = follow(exact, 0, exact.num_slots, REFERENCE)
    off = [replace(person, joints_m=person.joints_m + 0.05) for person in people]
    seen = clearly_seen(exact, off, 3)
    for before, after in zip(people, seen, strict=True):
        moved = np.linalg.norm(after.joints_m - before.joints_m, axis=-1)
        assert np.nanmedian(moved) < 0.01  # where cameras see joints, not where they were put
    lost = clearly_seen(
        replace(exact, views=tuple(_only(v, range(0)) for v in exact.views)), off, 3
    )
    np.testing.assert_array_equal(lost[0].joints_m, off[0].joints_m)


def test_nobody_is_followed_through_slots_that_are_left_out() -> None:
    poisoned = replace(noisy(), views=tuple(_only(v, range(15, 30)) for v in noisy().views))
    assert follow(poisoned, 0, 15, REFERENCE) == []
    assert estimated_clips(poisoned, 5, [(0, 15), (30, 40)], REFERENCE, ALONE) == []
    assert len(estimated_clips(poisoned, 5, [(15, 30)], REFERENCE, ALONE)) > 0


def _only(series: ViewSeries, slots: range) -> ViewSeries:
    views, kept = [], []
    for slot in slots:
        view = series.view(slot)
        if view is not None:
            views.append(view)
            kept.append(slot)
    return ViewSeries.from_views(views, kept, [0.05 * s for s in kept], 17)


def test_scored_slots_are_left_out_unless_asked_for() -> None:
    scored = replace(noisy(), scored_slots=(15, 28))
    assert free_stretches(scored, False) == [(0, 15), (28, 40)]
    assert free_stretches(scored, True) == [(0, 40)]
    targets: tuple[Target, ...] = ("truth", "estimates")
    for target in targets:
        settings = ClipSettings(target=target, estimates=replace(REFERENCE, combinations=2))
        kept = training_clips(scored, 5, settings, ALONE)
        assert kept and max(len(clip.joints_m) for clip in kept) <= 15
        assert not any(clip.scored for clip in kept)
        all_of_it = training_clips(scored, 5, replace(settings, include_scored=True), ALONE)
        assert max(len(clip.joints_m) for clip in all_of_it) > 15
        assert all(clip.scored for clip in all_of_it)


def test_a_recording_scored_from_end_to_end_teaches_nothing() -> None:
    with pytest.raises(InputError, match=r"not scored.*--include-scored"):
        training_clips(replace(noisy(), scored_slots=(0, 40)), 5, ClipSettings(), ALONE)


def test_auto_takes_truth_where_there_is_some_to_learn() -> None:
    settings = ClipSettings(estimates=replace(REFERENCE, combinations=2))
    assert training_clips(noisy(), 5, settings, ALONE)[0].errors_m is None
    assert training_clips(replace(noisy(), truth=None), 5, settings, ALONE)[0].errors_m is not None


def test_one_camera_cannot_teach() -> None:
    nothing = ViewSeries.from_views([], [], [], 17)
    single = replace(noisy(), truth=None, views=(noisy().views[0], nothing, nothing, nothing))
    with pytest.raises(InputError, match="found those of 1 cameras"):
        training_clips(single, 5, ClipSettings(estimates=REFERENCE), ALONE)


def gliding(errors_m: NDArray[np.float16] | None, slots: int = 60) -> Clip:
    return replace(gliding_clip(slots), errors_m=errors_m)


def test_a_window_is_given_estimates_and_asked_for_the_target() -> None:
    lifted = np.zeros((60, 3, NUM_COMMON, 3), np.float16)
    lifted[..., 2] = np.array([0.1, 0.2, 0.3])[:, None]
    clean = Corruption(exact=1.0, missing=0.0, short=0.0)
    windows = Sampler([gliding(lifted)], 10, 5).draw(np.random.default_rng(0), 300, clean)
    exact = Sampler([gliding(None)], 10, 5).draw(np.random.default_rng(0), 300, clean)
    heights = windows.normal.newest_m[..., 2] - windows.normal.newest_m[..., 2].min(axis=1)[:, None]
    np.testing.assert_allclose(heights.min(axis=1), 0, atol=1e-9)
    # In the person's frame the future lies as much lower as the newest slot was lifted, times the
    # size that the window is drawn at.
    lift = -windows.future_m[..., 2].mean(axis=(0, 2))
    assert np.isfinite(exact.future_m).all()
    groups = np.abs(lift[:, None] / [0.1, 0.2, 0.3] - 1).min(axis=1)
    assert (groups < 0.2).mean() > 0.99
    assert {int(np.abs(x / np.array([0.1, 0.2, 0.3]) - 1).argmin()) for x in lift} == {0, 1, 2}


def test_motion_without_variety_is_as_recorded_and_its_targets_are_estimates() -> None:
    lifted = np.zeros((60, 2, NUM_COMMON, 3), np.float16)
    lifted[..., 2] = np.array([0.0, 0.5])[:, None]
    sampler = Sampler([gliding(lifted)], 10, 5, variety="none")
    joints, history, interval = sampler.motion(np.random.default_rng(0), 200, Corruption())
    pose = gliding(None).joints_m
    assert (interval == 1 / 30).all() and np.isfinite(history).all()
    for part in (joints[10:], history):
        shape = part - part[:, :, :1]  # the body as it is, neither scaled nor mirrored
        np.testing.assert_allclose(
            shape, np.broadcast_to(pose[0] - pose[0, :1], shape.shape), atol=1e-3
        )
        level = part[..., 0, 2] - pose[0, 0, 2]
        assert np.isclose(level, 0.5, atol=1e-3).mean() == pytest.approx(0.5, abs=0.05)


def test_motion_without_other_bodies_keeps_the_lengths_of_limbs() -> None:
    def thigh_m(variety: Variety) -> Floats:
        sampler = Sampler([gliding(None)], 10, 5, variety=variety)
        joints, _, _ = sampler.motion(np.random.default_rng(0), 100, Corruption())
        return np.asarray(np.linalg.norm(joints[0, :, 0] - joints[0, :, 2], axis=-1))

    assert np.ptp(thigh_m("bodies")) > 0.01
    left, right = (
        np.linalg.norm(gliding(None).joints_m[0, hip] - gliding(None).joints_m[0, knee])
        for hip, knee in ((0, 2), (1, 3))
    )
    mirrored = np.minimum(abs(thigh_m("motion") - left), abs(thigh_m("motion") - right))
    assert mirrored.max() < 1e-3


def test_a_joint_that_the_drawn_estimate_lacks_is_missing() -> None:
    errors = np.zeros((60, 2, NUM_COMMON, 3), np.float16)
    errors[:, 1, 4] = np.nan
    clean = Corruption(exact=1.0, missing=0.0, short=0.0)
    windows = Sampler([gliding(errors)], 10, 5).draw(np.random.default_rng(0), 200, clean)
    measured = windows.normal.features.reshape(10, 200, 7, NUM_COMMON)[:, :, 6]
    # Half of the estimates lack an ankle, which is the other one in mirrored windows.
    assert measured[..., [4, 5]].mean() == pytest.approx(0.75, abs=0.03)
    assert measured[..., :4].all() and measured[..., 6:].all()


def test_held_out_ends_keep_their_estimates() -> None:
    errors = np.arange(3000, dtype=np.float16)[:, None, None, None] * np.ones((1, 2, NUM_COMMON, 3))
    clip = gliding(errors.astype(np.float16), slots=3000)
    (training,), (validation,) = hold_out_ends([clip], 0.2, 25)
    for part in (training, validation):
        assert part.errors_m is not None and len(part.errors_m) == len(part.joints_m)
    assert validation.errors_m is not None and validation.errors_m[0, 0, 0, 0] == np.float16(2400)


def test_recordings_without_truth_are_gathered() -> None:
    settings = ClipSettings(target="estimates", estimates=replace(REFERENCE, combinations=2))
    learned, groups = gather(
        [noisy()],
        [replace(noisy(), name="another", truth=None)],
        0.2,
        15,
        lambda recording, shortest: training_clips(recording, shortest, settings, ALONE),
    )
    assert all(clip.errors_m is not None for clip in learned)
    assert [name for name, _ in groups] == ["another"]
