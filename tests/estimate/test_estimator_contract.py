"""What every estimator promises, and what a replay with each of them finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.estimate import ESTIMATORS, Estimate, EstimatorSettings, estimator_maker
from e3pose.estimate.base import Estimator
from e3pose.estimate.per_slot.fuse import FusionSettings
from e3pose.evaluate.figures import expected_figures
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording
from e3pose.select.expected_information import foresee
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")


@cache
def scene() -> Recording:
    return simulate(SceneSettings(scene="ring", people=3, seconds=4, cameras=5), seed=3)


def estimator_of(name: str, recording: Recording, history_slots: int = 5) -> Estimator[Any]:
    return estimator_maker(name)(
        EstimatorSettings(
            recording.rig,
            recording.skeleton,
            recording.interval_s,
            history_slots,
            FusionSettings(),
            noise=SIMULATED,
        )
    )


def run(name: str, slots: Sequence[Mapping[int, Poses2D]]) -> list[Estimate]:
    estimator = estimator_of(name, scene())
    memory, found = estimator.begin(), []
    for slot, views in enumerate(slots):
        memory, made = estimator.estimate(memory, views, slot * scene().interval_s, lambda: 0.0)
        found.append(made)
    return found


def views_of(slot: int, cameras: tuple[int, ...] = (0, 1, 2, 3, 4)) -> dict[int, Poses2D]:
    views = {camera: scene().view(slot, camera) for camera in cameras}
    return {camera: view for camera, view in views.items() if view is not None}


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_shapes_fit_and_history_ends_with_this_slot(name: str) -> None:
    for made in run(name, [views_of(slot) for slot in range(20)]):
        people, history_m = made.people, made.history.joints_m
        assert len(people.track_ids) == len(people) == len(set(people.track_ids.tolist()))
        assert history_m.shape[0] == 5
        assert history_m.shape[2:] == (17, 3)
        rows = made.history.track_ids.tolist()
        for pose, measured, track in zip(
            people.joints_m, people.measured, people.track_ids.tolist(), strict=True
        ):
            newest = history_m[-1, rows.index(track)]
            known = np.isfinite(newest).all(axis=-1)  # what was filled is in no history
            assert (known | ~measured).all()
            np.testing.assert_array_equal(pose[known], newest[known])


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_slots_without_a_view_are_normal(name: str) -> None:
    nothing: list[Mapping[int, Poses2D]] = [{}, {}, {2: Poses2D.empty(17)}]
    for made in run(name, nothing):
        assert len(made.people) == 0 == made.history.joints_m.shape[1]


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_the_same_views_give_the_same_people(name: str) -> None:
    slots = [views_of(slot, (slot % 5, (slot + 2) % 5)) for slot in range(20)]
    for first, second in zip(run(name, slots), run(name, slots), strict=True):
        np.testing.assert_array_equal(first.people.track_ids, second.people.track_ids)
        np.testing.assert_array_equal(first.people.joints_m, second.people.joints_m)


def test_memory_finds_with_one_camera_what_the_paper_cannot() -> None:
    slots = [views_of(slot, (slot * 2 % 5,)) for slot in range(60)]
    assert all(len(made.people) == 0 for made in run("paper", slots))
    truth = scene().truth
    assert truth is not None
    for slot, made in list(enumerate(run("memory", slots)))[40:]:
        there = np.isfinite(truth.joints_m[slot]).all(axis=(1, 2))
        apart = np.linalg.norm(
            made.people.joints_m[:, None] - truth.joints_m[slot][None, there], axis=-1
        )
        assert (np.nanmean(apart, axis=-1).min(axis=0) < 0.2).all()


def test_a_replay_with_memory_counts_the_right_people() -> None:
    settings = ReplaySettings(pipeline="memory", policy="round-robin", num_selected=2)
    records = list(replay(scene(), settings))
    assert set(records[-1].stage_s) == {"estimate", "predict", "occlusion", "select"}
    assert all(record.arrived.sum() <= 2 for record in records[10:])
    poses = [record.people for record in records]
    assert len({len(p) for p in poses[15:]}) <= 2


def test_unknown_estimator_is_refused() -> None:
    with pytest.raises(InputError, match="found 'oracle', expected one of paper, memory"):
        estimator_maker("oracle")


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_every_joint_has_a_covariance_and_says_whether_it_was_measured(name: str) -> None:
    for made in run(name, [views_of(slot, (slot % 5, (slot + 2) % 5)) for slot in range(20)]):
        people = made.people
        shape = people.scores.shape
        assert people.covariance_m2.shape == (*shape, 3, 3)
        assert people.measured.shape == shape
        assert not (people.measured & (people.scores == 0)).any()
        known = people.scores > 0
        assert (np.linalg.eigvalsh(people.covariance_m2[known]) > 0).all()
        assert np.isnan(people.covariance_m2[~known]).all()


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_the_outlook_grows_less_certain_and_names_those_of_the_history(name: str) -> None:
    estimator = estimator_of(name, scene())
    memory = estimator.begin()
    for slot in range(20):
        memory, made = estimator.estimate(memory, views_of(slot), slot * 0.04, lambda: 0.0)
    soon, late = (estimator.outlook(memory, ahead_s).expected for ahead_s in (0.04, 0.4))
    outlook = estimator.outlook(memory, 0.04)
    foresights = [foresee(scene().rig, outlook, 0.04, np.zeros((n, 5), dtype=bool)) for n in (0, 9)]
    assert set(made.history.track_ids.tolist()) <= set(soon.track_ids.tolist())
    assert made.history.joints_m.shape[1] == len(made.history.track_ids)
    assert np.isfinite(soon.joints_m).all()
    assert soon.delivered.shape == soon.last_seen_s.shape == (len(soon.track_ids), 5)
    assert (soon.delivered >= 0).all() and (soon.delivered <= 1).all()
    assert late.joints_m.shape == soon.joints_m.shape
    nobody = np.zeros((1, 5), dtype=bool)
    errors_m = [float(foresight.expected_error_m(nobody)[0]) for foresight in foresights]
    assert errors_m[1] >= errors_m[0] > 0


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_the_stated_uncertainty_is_honest(name: str) -> None:
    """About nine of ten joints lie within the band, and the expected error is not far off."""
    settings = ReplaySettings(pipeline=name, policy="round-robin", num_selected=3)
    figures = expected_figures(scene(), list(replay(scene(), settings)))
    assert figures.coverage_90 is not None and 80 < figures.coverage_90 < 99
    assert figures.actual_mm is not None and figures.matched_mm is not None
    assert 0.6 < figures.actual_mm / figures.matched_mm < 1.4


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_ids_left_out_are_given_to_nobody(name: str) -> None:
    estimator, found = estimator_of(name, scene()), []
    for count in (0, 100):
        memory = estimator.leave_out_ids(estimator.begin(), count)
        for slot in range(12):
            memory, made = estimator.estimate(
                memory, views_of(slot), slot * scene().interval_s, lambda: 0.0
            )
        found.append(made.people.track_ids)
    assert len(found[0]) == 3
    np.testing.assert_array_equal(found[1], found[0] + 100)
