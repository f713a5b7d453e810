"""The loop body: Algorithm 1, its lead, its warm-up, and its queues."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.estimate.filter.room import BODY
from tests.five_cameras import (
    BUDGET,
    FORESIGHT,
    NUM_CAMERAS,
    NUM_JOINTS,
    ONLINE,
    Recorder,
    make,
    run,
    scene,
)

from e3pose.base.arrays import Floats
from e3pose.energy.queues import Queue
from e3pose.estimate.base import Estimate
from e3pose.model.pose import Poses2D
from e3pose.pipeline import initial_state, step
from e3pose.predict import Prediction, make_predictor
from e3pose.select.policies import Selection, Situation


def test_people_are_where_they_are_and_keep_their_identity() -> None:
    records = run(make(), [scene(slot) for slot in range(30)])
    for record in records:
        order = np.argsort(record.people.joints_m[:, 0, 0])
        expected = np.stack([BODY, BODY + [0.8, 0.02 * record.slot, 0]])
        by_x = np.argsort(expected[:, 0, 0])
        np.testing.assert_allclose(record.people.joints_m[order], expected[by_x], atol=1e-6)
    assert len({tuple(sorted(record.people.track_ids)) for record in records}) == 1
    np.testing.assert_allclose([record.time_s for record in records], np.arange(30) * 0.04)


def test_all_cameras_warm_up_then_exactly_c_detect() -> None:
    counts = [int(r.selected.sum()) for r in run(make(), [scene(s) for s in range(20)])]
    assert counts == [5] * 4 + [2] * 16


def test_as_published_the_first_decision_is_for_slot_m_plus_tau() -> None:
    records = run(make(queue=Queue(BUDGET, as_published=True)), [scene(slot) for slot in range(20)])
    assert [int(r.selected.sum()) for r in records] == [5] * 6 + [2] * 14
    assert not any(r.deficit.any() for r in records[:4])  # the warm-up is not charged
    np.testing.assert_allclose(records[4].deficit, records[4].next_selection)


def test_as_published_the_queue_alone_is_charged_whatever_cameras_cost() -> None:
    prices = {}
    for as_published in (False, True):
        policy = Recorder([])
        costs = np.array([2.0, 1.0, 1.0, 1.0, 1.0])
        pipeline = make(policy=policy, queue=Queue(BUDGET, costs, as_published))
        run(pipeline, [scene(slot) for slot in range(12)])
        (prices[as_published], deficit) = (policy.seen[-1].price, policy.seen[-1].deficit)
        assert deficit[:2].min() > 0
    np.testing.assert_array_equal(prices[True], deficit)
    assert prices[False][0] > deficit[0] and prices[False][1] < deficit[1]


def test_a_decision_is_used_lead_slots_later() -> None:
    records = run(make(), [scene(slot) for slot in range(20)])
    for earlier, later in zip(records, records[2:], strict=False):
        np.testing.assert_array_equal(earlier.next_selection, later.selected)


def test_queues_follow_the_paper() -> None:
    records = run(make(), [scene(slot) for slot in range(25)])
    deficit = np.zeros(NUM_CAMERAS)
    for record in records:
        if record.slot + 2 >= 4:  # the warm-up is not charged
            deficit = np.maximum(deficit - 0.6, 0) + record.next_selection
        np.testing.assert_allclose(record.deficit, deficit)


def test_a_saved_state_continues_exactly() -> None:
    pipeline = make("random")
    state, rest = initial_state(pipeline), []
    for slot in range(20):
        if slot == 10:
            saved = state
        state, record = step(pipeline, state, scene(slot), ONLINE)
        rest.append(record)
    state = saved
    for slot in range(10, 20):
        state, record = step(make("random"), state, scene(slot), ONLINE)
        np.testing.assert_array_equal(record.next_selection, rest[slot].next_selection)
        np.testing.assert_array_equal(record.people.joints_m, rest[slot].people.joints_m)
        np.testing.assert_array_equal(record.people.track_ids, rest[slot].people.track_ids)


@pytest.mark.parametrize("views", [{}, {0: Poses2D.empty(NUM_JOINTS)}])
def test_nobody_and_nothing_are_normal(views: Mapping[int, Poses2D]) -> None:
    for record in run(make(), [views] * 10):
        assert len(record.people) == 0
        assert (record.occlusion == 0).all()


def test_people_are_reported_before_cameras_are_selected_for_later() -> None:
    published: list[Estimate] = []
    order: list[str] = []
    predictor = make_predictor("constant-velocity")

    class Listening:
        def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
            order.append("predict")
            return predictor.predict(history_m, interval_s, lead_slots)

    def tell(estimate: Estimate) -> None:
        order.append("tell")
        published.append(estimate)

    pipeline = make(predictor=Listening())
    _, record = step(pipeline, initial_state(pipeline), scene(0), ONLINE, tell)
    assert order == ["tell", "predict"]
    assert len(published[0].people) == 2
    np.testing.assert_array_equal(published[0].people.joints_m, record.people.joints_m)
    np.testing.assert_array_equal(published[0].people.track_ids, record.people.track_ids)


def test_held_slots_show_the_last_poses() -> None:
    pipeline = make("central-2d")  # a round trip of 0.05 s is two slots
    records = run(pipeline, [scene(slot) for slot in range(12)])
    asleep = [record for record in records if not record.selected.any()]
    assert asleep
    for record in asleep:
        before = records[record.slot - 1]
        np.testing.assert_array_equal(record.people.joints_m, before.people.joints_m)


def test_slots_without_a_camera_are_failures_for_other_policies() -> None:
    nobody = replace(make(), policy=Asleep())
    assert [len(record.people) for record in run(nobody, [scene(s) for s in range(8)])][4:] == [
        0
    ] * 4


class Asleep:
    """A policy that never wakes a camera."""

    def select(self, situation: Situation) -> Selection:
        return np.zeros(NUM_CAMERAS, dtype=bool)


def test_reasons_are_given_for_the_slot_that_was_decided() -> None:
    records = run(make("information", needs=FORESIGHT), [scene(slot) for slot in range(20)])
    for record in records:
        assert record.reasons is not None
        assert record.reasons.slot == record.slot + 2
        assert record.reasons.gain_nats.shape == (NUM_CAMERAS,)
        assert (record.reasons.gain_nats >= -1e-12).all()
    for earlier, record in pairwise(records):
        assert record.reasons is not None
        np.testing.assert_allclose(record.reasons.price, earlier.deficit)
    assert all(record.reasons is None for record in run(make(), [scene(0)] * 3))


def test_each_stage_is_timed_by_itself() -> None:
    times = iter(np.arange(100.0, 1000.0).tolist())
    record = run(make(clock=lambda: next(times)), [scene(0)])[0]
    assert {record.stage_s[name] for name in ("predict", "occlusion", "select")} == {1.0}


def test_a_decision_is_for_so_many_seconds_ahead() -> None:
    assert make(lead_slots=3).ahead_s == pytest.approx(0.12)
