"""The loop's blinkers: views that nobody asked for, cameras that are away or do not answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.cases import each_case
from tests.five_cameras import (
    FORESIGHT,
    NUM_CAMERAS,
    NUM_JOINTS,
    ONLINE,
    Recorder,
    make,
    run,
    scene,
)

from e3pose.base.arrays import Flags, Integers
from e3pose.energy.queues import Queue
from e3pose.model.pose import Poses2D
from e3pose.pipeline import initial_state, step
from e3pose.select.policies import POLICIES, Policy, PolicySettings, Selection, Situation
from e3pose.select.rest_plan import RestMemory


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
