"""The loop of a slot: stages, cameras that differ, predictors, what cameras are told to expect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import BODY
from tests.five_cameras import (
    BUDGET,
    FORESIGHT,
    NUM_CAMERAS,
    NUM_JOINTS,
    ONLINE,
    RIG,
    SIMULATED,
    Recorder,
    make,
    run,
    scene,
)

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.energy.queues import Queue
from e3pose.estimate.base import STEER_SLOTS, Estimate
from e3pose.estimate.filter import Model
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord, initial_state, step
from e3pose.predict import Prediction, make_predictor
from e3pose.select.feedback import Feedback, expected_people
from e3pose.select.policies import POLICIES, Policy, PolicySettings, Selection, Situation
from e3pose.select.rest_plan import RestMemory


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


def test_queues_follow_the_paper_and_decisions_are_used_lead_slots_later() -> None:
    records = run(make(), [scene(slot) for slot in range(25)])
    deficit = np.zeros(NUM_CAMERAS)
    for record in records:
        if record.slot + 2 >= 4:  # the warm-up is not charged
            deficit = np.maximum(deficit - 0.6, 0) + record.next_selection
        np.testing.assert_allclose(record.deficit, deficit)
    for earlier, later in zip(records, records[2:], strict=False):  # of a lead of two slots
        np.testing.assert_array_equal(earlier.next_selection, later.selected)


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


def test_a_policy_cannot_see_an_unselected_view() -> None:
    """Whatever unselected cameras see, estimate and situation are the same to the last bit."""
    rng = np.random.default_rng(5)
    outcomes = []
    for garbage in (False, True):
        policy = Recorder([])
        views = [scene(slot) for slot in range(15)]
        if garbage:
            for slot in range(4, 15):
                for camera in (2, 3, 4):
                    pixels = rng.uniform(0, 800, (3, NUM_JOINTS, 2))
                    views[slot][camera] = Poses2D(pixels, np.ones((3, NUM_JOINTS)))
        records = run(replace(make(), policy=policy), views)
        outcomes.append((records, policy.seen))
    for clean, dirty in zip(outcomes[0][0], outcomes[1][0], strict=True):
        np.testing.assert_array_equal(clean.people.joints_m, dirty.people.joints_m)
        np.testing.assert_array_equal(clean.arrived, dirty.arrived)
    for clean_now, dirty_now in zip(outcomes[0][1], outcomes[1][1], strict=True):
        for name in ("occlusion", "own_occlusion", "visibility", "deficit", "unseen_slots"):
            np.testing.assert_array_equal(getattr(clean_now, name), getattr(dirty_now, name))


def test_the_guard_bites_when_a_selected_view_changes() -> None:
    views = [scene(slot) for slot in range(15)]
    before = run(replace(make(), policy=Recorder([])), views)
    shifted = views[10][0]
    views[10][0] = Poses2D(shifted.keypoints_px + 5, shifted.scores)
    after = run(replace(make(), policy=Recorder([])), views)
    assert (before[10].people.joints_m != after[10].people.joints_m).any()


def test_offline_cameras_are_neither_read_nor_ordered() -> None:
    online = np.array([True, True, False, True, True])
    records = run(make(), [scene(slot) for slot in range(20)], online)
    assert not any(record.selected[2] or record.arrived[2] for record in records)
    assert all(record.next_selection[online].sum() == 2 for record in records[2:])


def test_an_order_to_a_camera_that_went_offline_is_not_expected_to_be_followed() -> None:
    policy = Recorder([])  # cameras 0 and 1
    pipeline = make(policy=policy, lead_slots=3)
    state = initial_state(pipeline)
    for slot in range(12):
        online = np.array([True, slot < 10, True, True, True])
        state, _ = step(pipeline, state, scene(slot), online)
    # Slot 11 decides slot 14: camera 0 is expected to detect in slot 13, camera 1 did in slot 9.
    assert policy.seen[-1].unseen_slots[:2].tolist() == [1, 5]


@each_case(("retry_slot", "unseen"), [(11, 2), (12, 2), (13, 15)])
def test_a_camera_that_was_given_up_is_expected_from_its_next_try_on(
    retry_slot: int, unseen: int
) -> None:
    policy = Recorder([])
    pipeline = make(policy=policy, lead_slots=4)
    state = initial_state(pipeline)
    orders = state.selections.copy()  # of slots 10 to 13
    orders[:, 1] = [False, True, True, False]
    retry = np.array([0, retry_slot, 0, 0, 0])
    silence = replace(state.silence, retry_slot=retry)
    step(pipeline, replace(state, slot=10, selections=orders, silence=silence), scene(10), ONLINE)
    assert policy.seen[-1].unseen_slots.tolist() == [1, unseen, 1, 1, 1]


@each_case("policy", ["round-robin", "e3pose-mv", "information", "random"])
def test_a_camera_that_never_answers_is_given_up_and_made_up_for(policy: str) -> None:
    views = [scene(slot) for slot in range(90)]
    for slot in range(20, 70):
        del views[slot][3]  # nobody says that it is gone
    # Budgets without slack: every camera has its turns, however occluded.
    records = run(make(policy, needs=FORESIGHT, queue=Queue(np.full(NUM_CAMERAS, 0.4))), views)
    asked = [record.slot for record in records if record.selected[3] and not record.arrived[3]]
    # Five misses, what was ordered meanwhile, and a try a second later.
    assert 5 <= len(asked) <= 9
    assert all(record.selected.sum() == 2 for record in records[6:])


def test_a_sleeping_camera_is_not_selected_and_its_silence_is_no_failure() -> None:
    pipeline = make("round-robin")
    state = initial_state(pipeline)
    until = 30
    for slot in range(until + 5):
        if slot == 15:
            asleep = np.zeros(NUM_CAMERAS, dtype=np.int64)
            asleep[1] = until
            state = replace(state, asleep_until=asleep)
        views = scene(slot)
        if 15 < slot < until:
            del views[1]
        state, record = step(pipeline, state, views, ONLINE)
        assert not (record.next_selection[1] and 15 <= slot < until - pipeline.lead_slots)
        if slot >= pipeline.warmup_slots:
            assert record.next_selection.sum() == 2
        assert record.asleep_until[1] == (until if slot >= 15 else 0)
    assert state.silence.failures[1] == 0


class Planner:
    """Lets camera 2 sleep until slot 12, and three of the others look."""

    def __init__(self) -> None:
        self.charges: list[tuple[bool, int]] = []
        self.slept: list[tuple[int, list[bool]]] = []

    def planned(
        self, rest: RestMemory, situation: Situation, until: Integers, later: object, asked: object
    ) -> tuple[RestMemory, Integers]:
        return replace(rest, num_selected=3.0), np.array([0, 0, 12, 0, 0])

    def checked(
        self, rest: RestMemory, slot: int, interval_s: float, asleep: Flags, error_m: float
    ) -> RestMemory:
        self.slept.append((slot, asleep.tolist()))
        return rest

    def charged(
        self, rest: RestMemory, decision: Selection, asleep: Selection, interval_s: float
    ) -> RestMemory:
        self.charges.append((bool(asleep[2]), int(decision.sum())))
        return rest


def test_a_plan_of_rests_says_who_looks_and_is_charged_for_those_who_sleep() -> None:
    planner = Planner()

    def waking(count: float) -> Policy:
        return POLICIES["round-robin"].make(PolicySettings(num_selected=count))

    records = run(make("round-robin", rests=planner, waking=waking), [scene(i) for i in range(20)])
    decided = [record for record in records if record.slot + 2 >= 4]  # after the warm-up
    assert [asleep for asleep, _ in planner.charges] == [r.slot + 2 < 12 for r in decided]
    assert {count for _, count in planner.charges} == {3}
    slept = [[slot < 12 and slot >= 3 and camera == 2 for camera in range(5)] for slot in range(20)]
    assert planner.slept == [(slot, slept[slot]) for slot in range(planner.slept[0][0], 20)]
    assert not any(record.next_selection[2] for record in decided if record.slot + 2 < 12)
    assert any(record.next_selection[2] for record in decided)


def test_cameras_are_reported_whom_to_expect_but_for_one_look_in_so_many() -> None:
    records = run(make("all", feedback=Feedback(5)), [scene(slot) for slot in range(40)])
    silent = run(make("all"), [scene(slot) for slot in range(20)])
    assert all(record.expected is None for record in silent), "without feedback"
    published = [record.expected is not None for record in records]
    assert not any(published[:2])  # the warm-up, two slots ahead
    first = published.index(True)
    assert published[first:] == ([True] * 4 + [False]) * 7 + [True] * (len(published) - first - 35)


def test_people_are_expected_where_they_are_in_the_slot_of_the_order() -> None:
    records = run(make("all", feedback=Feedback(1000)), [scene(slot) for slot in range(30)])
    for record in records[-10:]:
        assert record.expected is not None
        for camera, view in enumerate(record.expected):
            truth = scene(record.slot + 2)[camera].keypoints_px
            assert len(view) == len(truth) == 2
            off = np.linalg.norm(view.keypoints_px[:, None] - truth[None], axis=-1).mean(axis=-1)
            assert off.min(axis=1).max() < 5.0 and set(off.argmin(axis=1)) == {0, 1}


class Doubting:
    """Foresees nobody to move, and doubts a slot ahead by as many metres as it is ahead."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        joints_m = np.repeat(history_m[-1:], lead_slots, axis=0)
        ahead = np.arange(1.0, lead_slots + 1)[:, None, None]
        return Prediction(joints_m, np.broadcast_to(ahead, joints_m.shape[:-1]))


def test_people_are_expected_with_the_error_of_the_slot_of_the_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[Floats]()

    def expected(rig: Any, joints_m: Floats, error_m: Floats, *more: Any) -> Any:
        told.append(error_m)
        return expected_people(rig, joints_m, error_m, *more)

    monkeypatch.setattr("e3pose.pipeline.expected_people", expected)
    loop = make("all", feedback=Feedback(1000), predictor=Doubting())
    run(loop, [scene(slot) for slot in range(12)])
    assert told and all((error_m == loop.lead_slots).all() for error_m in told)


def test_cameras_selected_together_look_at_all_of_their_image_together() -> None:
    records = run(make("round-robin", feedback=Feedback(4)), [scene(slot) for slot in range(80)])
    looks = np.zeros(NUM_CAMERAS, dtype=int)
    for record in records[4:]:
        chosen = record.next_selection
        looks = np.where(chosen, 0 if record.expected is None else looks + 1, looks)
        assert looks.max() < 4  # full-frame detection is never later
    shares = [record.expected is None for record in records[20:]]
    assert 1 / 4 <= np.mean(shares) <= 1 / 2


def test_nobody_expected_is_a_look_at_the_whole_image() -> None:
    nobody = {index: Poses2D.empty(NUM_JOINTS) for index in range(NUM_CAMERAS)}
    records = run(make("all", feedback=Feedback(5)), [nobody] * 20)
    assert all(record.expected is None for record in records)


@dataclass
class Shifting:
    """Foresees everybody aside in two slots and where they are in one; selects the same cameras.

    Attributes:
        error_m: that it states.
        shift_m: how far aside.
        slots_asked: how far it was asked to look ahead.
        situations: in which it selected.
    """

    error_m: float
    shift_m: float
    slots_asked: list[int] = field(default_factory=list)
    situations: list[Situation] = field(default_factory=list)

    def select(self, situation: Situation) -> Selection:
        self.situations.append(situation)
        return np.arange(NUM_CAMERAS) < 2

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        self.slots_asked.append(lead_slots)
        joints = np.repeat(history_m[-1:], lead_slots, axis=0)
        joints[1:] += [self.shift_m, 0.0, 0.0]
        return Prediction(joints, np.full(joints.shape[:-1], self.error_m))


def run_shifting(
    error_m: float, lead_slots: int, shift_m: float = 0.2, steers: bool = True
) -> tuple[Shifting, list[SlotRecord]]:
    both = Shifting(error_m, shift_m)
    pipeline = make(
        policy=both,
        predictor=both,
        needs=FORESIGHT,
        steering=both if steers else None,
        lead_slots=lead_slots,
        estimator=Filtered(Model(RIG, COCO17, SIMULATED), StepKernel(), 5),
    )
    return both, run(pipeline, [scene(slot) for slot in range(12)])


def test_a_predictor_of_the_policy_alone_does_not_steer() -> None:
    (_, unsteered), (_, plain) = (run_shifting(0.05, 3, steers=False), run_shifting(np.nan, 3))
    for one, other in zip(unsteered, plain, strict=True):
        np.testing.assert_array_equal(one.people.joints_m, other.people.joints_m)


def test_a_predictor_that_states_its_error_steers_the_estimator_and_feeds_the_choice() -> None:
    (stating, steered), (silent, plain) = (run_shifting(e, 3) for e in (0.05, np.nan))
    assert [len(record.people) for record in steered] == [len(record.people) for record in plain]
    aside = steered[-1].people.joints_m[:, :, 0] - plain[-1].people.joints_m[:, :, 0]
    assert (aside > 0).mean() > 0.95  # towards what was foreseen, as far as views allow
    published, untold = (each.situations[-1].foresight for each in (stating, silent))
    assert published is not None and untold is not None
    assert not np.allclose(published.views, untold.views, rtol=1e-3)


def test_policies_see_the_slot_decided_although_the_estimator_needs_two_ahead() -> None:
    (one, _), (two, _) = (run_shifting(np.nan, lead, shift_m=1000.0) for lead in (1, 2))
    assert set(one.slots_asked) == {1, STEER_SLOTS} and set(two.slots_asked) == {STEER_SLOTS}
    assert (one.situations[-1].visibility > 0.5).all()
    assert (two.situations[-1].visibility == 0).all()
