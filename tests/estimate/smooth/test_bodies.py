"""The smoother over bodies, against one big solution and on simulated people."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.reference.filter_motion import spread

from e3pose.estimate.base import Estimate, Posterior, Start
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth.bodies import FixedLag, body_transition, smooth_backwards, written_out
from e3pose.estimate.smooth.rauch import expect, step_back
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_records
from e3pose.evaluate.summary import accuracy
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

TREE = grow(COCO17)
BONES = proportions_of(COCO17, TREE)


@cache
def scene() -> Recording:
    return simulate(SceneSettings(scene="ring", people=3, seconds=8, fps=12.5), seed=701)


@pytest.fixture(scope="module")
def replayed() -> tuple[list[SlotRecord], list[Posterior]]:
    people: list[Estimate] = []
    settings = ReplaySettings(policy="round-robin", num_selected=1, seed=1, phase=1)
    records = list(replay(scene(), settings, publish=people.append))
    posteriors = [each.posterior for each in people if each.posterior is not None]
    assert len(posteriors) == len(records)
    return records, posteriors


def test_steps_back_are_the_least_squares_path_of_all_slots() -> None:
    rng = np.random.default_rng(0)
    F, Q, H, R = np.array([[1, 0.1], [0, 0.9]]), np.diag([0.01, 0.1]), np.array([[1.0, 0]]), 0.04
    seen = rng.normal(size=6)
    means, covariances, expected = [], [], []
    mean, covariance = np.zeros((2, 1)), np.eye(2)
    for value in seen:
        across = covariance @ F.T
        expected.append(expect(F @ mean, F @ across + Q, across))
        mean, covariance = expected[-1].mean, expected[-1].covariance
        K = covariance @ H.T / (H @ covariance @ H.T + R)
        mean, covariance = mean + K * (value - H @ mean), covariance - K @ H @ covariance
        means.append(mean)
        covariances.append(covariance)
    # All seven states at once: the start, six moves and six measurements.
    rows, values = [np.eye(2, 14)], [np.zeros(2)]
    for slot in range(6):
        move = np.zeros((2, 14))
        move[:, 2 * slot : 2 * slot + 2], move[:, 2 * slot + 2 : 2 * slot + 4] = -F, np.eye(2)
        rows += [np.linalg.inv(np.linalg.cholesky(Q)) @ move]
        values += [np.zeros(2)]
        look = np.zeros((1, 14))
        look[:, 2 * slot + 2 : 2 * slot + 4] = H
        rows, values = [*rows, look / R**0.5], [*values, seen[slot : slot + 1] / R**0.5]
    A = np.concatenate(rows)
    path = np.linalg.lstsq(A, np.concatenate(values), rcond=None)[0].reshape(7, 2)
    spreads = np.linalg.inv(A.T @ A)
    for slot in range(4, -1, -1):
        mean, covariance = step_back(
            means[slot], covariances[slot], expected[slot + 1], mean, covariance
        )
        np.testing.assert_allclose(mean[:, 0], path[slot + 1], atol=1e-9)
        block = spreads[2 * slot + 2 : 2 * slot + 4, 2 * slot + 2 : 2 * slot + 4]
        np.testing.assert_allclose(covariance, block, atol=1e-9)


def test_whole_bodies_move_on_as_the_filter_says(
    replayed: tuple[list[SlotRecord], list[Posterior]],
) -> None:
    posterior = replayed[1][40]
    whole = written_out(TREE, posterior.covariance, posterior.shared)
    shares = np.linspace(0.4, 2.0, 17 * len(whole)).reshape(len(whole), 17)
    move, noise = body_transition(TREE, 0.08, shares)
    after = (move @ whole @ move.T + noise).reshape(len(whole), 17, 6, 17, 6)
    covariance, shared = spread(TREE, posterior.covariance, posterior.shared, shares, 0.08)
    for joint, parent in enumerate(TREE.parents.tolist()):
        np.testing.assert_allclose(after[:, joint, :, joint], covariance[:, joint], atol=1e-12)
        if parent >= 0:
            np.testing.assert_allclose(after[:, joint, :, parent], shared[:, joint], atol=1e-12)
    state = posterior.state
    linear = (move @ state.reshape(len(state), -1, 1)).reshape(state.shape)
    np.testing.assert_allclose(linear, places(TREE, state, 0.08), atol=1e-12)


def test_the_last_slot_is_the_filters_own_and_others_are_surer(
    replayed: tuple[list[SlotRecord], list[Posterior]],
) -> None:
    _, posteriors = replayed
    found = [*smooth_backwards(TREE, reversed(posteriors))][::-1]
    np.testing.assert_array_equal(found[-1].joints_m, posteriors[-1].state[..., :3])
    for late in found[:-1]:
        assert (np.linalg.eigvalsh(late.covariance_m2) > 0).all()
        before = np.trace(late.posterior.covariance[..., :3, :3], axis1=-2, axis2=-1)
        after = np.trace(late.covariance_m2, axis1=-2, axis2=-1)
        assert after.mean() < before.mean() if len(after) else True
        assert (after < 1.1 * before).all()  # the filter keeps a tree, which is not quite all


def test_a_lag_of_everything_is_the_whole_interval(
    replayed: tuple[list[SlotRecord], list[Posterior]],
) -> None:
    posteriors = replayed[1][20:30]
    lag, whole = FixedLag(TREE, 9), [*smooth_backwards(TREE, reversed(posteriors))][::-1]
    for posterior in posteriors[:-1]:
        assert lag.push(posterior) is None
    late = lag.push(posteriors[-1])
    assert late is not None
    np.testing.assert_allclose(late.joints_m, whole[0].joints_m, atol=1e-12)
    np.testing.assert_allclose(late.covariance_m2, whole[0].covariance_m2, atol=1e-12)


@pytest.mark.parametrize(("lag", "error", "jitter"), [(2, 0.85, 0.5), (None, 0.85, 0.4)])
def test_waiting_lowers_error_and_jitter_with_one_camera(
    replayed: tuple[list[SlotRecord], list[Posterior]],
    lag: int | None,
    error: float,
    jitter: float,
) -> None:
    records, posteriors = replayed
    before = accuracy(scene(), records)
    after = accuracy(scene(), smooth_records(records, posteriors, scene().skeleton, lag))
    assert (after.mpjpe_mm or 99) < error * (before.mpjpe_mm or 0)
    assert (after.acceleration_error_mps2 or 99) < jitter * (before.acceleration_error_mps2 or 0)
    assert (after.recall_500mm or 0) >= (before.recall_500mm or 1)


def test_people_who_come_and_go_are_smoothed_by_themselves(
    replayed: tuple[list[SlotRecord], list[Posterior]],
) -> None:
    records, posteriors = replayed
    for record, late in zip(
        records, smooth_records(records, posteriors, scene().skeleton), strict=True
    ):
        assert record.people.track_ids.tolist() == late.people.track_ids.tolist()
        apart = np.linalg.norm(record.people.joints_m - late.people.joints_m, axis=-1)
        assert np.nanmean(apart) < 0.3 if len(apart) else True
        known = record.people.scores > 0
        np.testing.assert_array_equal(known, np.isfinite(late.people.joints_m).all(axis=-1))


def test_a_slot_starts_where_steering_left_the_one_before(
    replayed: tuple[list[SlotRecord], list[Posterior]],
) -> None:
    before, posterior = replayed[1][39:41]
    assert posterior.start.time_s == before.time_s
    np.testing.assert_array_equal(posterior.start.tracks, before.tracks)
    np.testing.assert_array_equal(posterior.start.state[..., :3], before.state[..., :3])
    assert (posterior.start.state[..., 3:] != before.state[..., 3:]).any()
    assert (posterior.start.drift_share < 1).any()


def test_nobody_is_nobody() -> None:
    none = np.zeros(0, dtype=np.int64)
    state, covariance = np.zeros((0, 17, 6)), np.zeros((0, 17, 6, 6))
    start = Start(0.0, none, state, np.ones((0, 17)))
    bones = np.zeros((0, len(BONES.bones)))
    places = covariance[..., :3, :3]
    empty = Posterior(
        0.0, none, none, state, covariance, covariance, bones, bones, start,
        state[..., 0], places, places, 0.0,
    )  # fmt: skip
    assert [late.joints_m.shape for late in smooth_backwards(TREE, [empty, empty])] == [
        (0, 17, 3)
    ] * 2
    assert [*smooth_backwards(TREE, [])] == []
