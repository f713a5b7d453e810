"""Under overload the edge leaves out work, says so, and takes it up again; it never flutters."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from e3pose.edge.overload import (
    BLAMED_S,
    CALM_S,
    FULL,
    HALF_RATE,
    HIGH,
    LONGEST_CALM_S,
    ROUND_ROBIN,
    SETTLED_S,
    EveryOther,
    Load,
    after_work,
    shed_load,
)
from e3pose.model.pose import Poses2D
from e3pose.pipeline import initial_state, step
from e3pose.select.camera_order import spread_order
from e3pose.select.policies import Need
from e3pose.select.policies.fixed import RoundRobin
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate import SceneSettings, simulate

INTERVAL_S = 0.04


def run(took_s: dict[int, float], seconds: float, load: Load | None = None) -> list[Load]:
    """Loads after each slot of a machine that takes `took_s` per slot, by level."""
    loads = [load or Load()]
    for _ in range(round(seconds / INTERVAL_S)):
        loads.append(after_work(loads[-1], took_s[loads[-1].level], INTERVAL_S, awake=2))
    return loads


def test_a_machine_that_is_fast_enough_leaves_nothing_out() -> None:
    loads = run({FULL: 0.7 * INTERVAL_S}, 60)
    assert {load.level for load in loads} == {FULL}
    assert loads[-1].awake == pytest.approx(2)
    load = after_work(run({FULL: 0.1 * INTERVAL_S}, 10)[-1], 10 * INTERVAL_S, INTERVAL_S, 2)
    assert load.level == FULL and load.busy < HIGH  # after one slow slot


def test_the_cheaper_choice_comes_first_then_every_other_slot_and_all_work_comes_back() -> None:
    loads = run({FULL: 1.2 * INTERVAL_S, ROUND_ROBIN: 0.6 * INTERVAL_S}, 120)
    levels = [load.level for load in loads]
    assert levels[-1] == ROUND_ROBIN and levels.count(FULL) * INTERVAL_S < 2 * SETTLED_S
    slow = {FULL: 3 * INTERVAL_S, ROUND_ROBIN: 1.5 * INTERVAL_S, HALF_RATE: 0.7 * INTERVAL_S}
    busy = run(slow, 10)[-1]
    assert busy.level == HALF_RATE
    quick = dict.fromkeys(slow, 0.1 * INTERVAL_S)
    assert run(quick, 2 * CALM_S + 5, busy)[-1].level == FULL


def test_it_does_not_flutter_where_less_load_is_due_to_leaving_out() -> None:
    loads = run({FULL: 1.2 * INTERVAL_S, ROUND_ROBIN: 0.2 * INTERVAL_S}, 3600)
    changes = sum(a.level != b.level for a, b in pairwise(loads))
    assert loads[-1].wait_s == LONGEST_CALM_S
    assert changes < 30


def test_overload_is_told_and_no_camera_judged_until_its_delays_are_gone() -> None:
    slow = {FULL: 1.5 * INTERVAL_S, ROUND_ROBIN: 0.6 * INTERVAL_S}
    assert not any(load.overloaded() or load.message() for load in run({FULL: 0.01}, 60))
    busy = run(slow, 1.2)[-1]
    assert busy.overloaded() and busy.level == FULL
    assert busy.message().startswith("edge overloaded, computing takes 1")
    shed = run(slow, 40, busy)[-1]  # it keeps up since it selects by round robin
    assert shed.level == ROUND_ROBIN and not shed.overloaded()
    assert shed.message().endswith("60% of a slot: cameras are selected by round robin")
    calm = run(dict.fromkeys(slow, 0.01), BLAMED_S - 1, busy)[-1]
    assert calm.overloaded() and "re-checking cameras" in calm.message()
    assert run(dict.fromkeys(slow, 0.01), BLAMED_S + 2, busy)[-1].message() == ""


def test_edge_that_is_behind_is_overloaded_though_it_computes_little() -> None:
    load = Load()
    for _ in range(50):  # another program takes the machine
        load = after_work(load, 0.01, INTERVAL_S, 2, behind_s=0.5)
    assert load.overloaded() and load.level == FULL
    assert load.message() == "this computer is too busy: poses come 0.4 s late"


def test_shed_load_takes_turns_without_a_foresight() -> None:
    scene = simulate(SceneSettings("ring", people=1, seconds=1, cameras=4), seed=8)
    pipeline = make_pipeline(scene, ReplaySettings(num_selected=2))
    assert shed_load(pipeline, Load()) is pipeline
    cheap = shed_load(pipeline, Load(level=ROUND_ROBIN, awake=2.0))
    assert (
        cheap.policy == RoundRobin(2.0, order=spread_order(scene.rig))
        and Need.FORESIGHT not in cheap.needs
    )
    resting = make_pipeline(scene, ReplaySettings(num_selected=2, rest="asleep"))
    assert resting.rests is not None and shed_load(resting, Load(level=ROUND_ROBIN)).rests is None
    rare = shed_load(pipeline, Load(level=HALF_RATE, awake=1.0))
    state, online, woken = initial_state(rare), np.ones(4, dtype=bool), []
    nobody = Poses2D(np.zeros((0, 17, 2)), np.zeros((0, 17)))
    for _ in range(40):
        state, record = step(rare, state, dict.fromkeys(range(4), nobody), online)
        woken.append(np.flatnonzero(record.next_selection).tolist())
    later = woken[12:]
    assert sum(map(bool, later)) == len(later) / 2
    assert {camera for cameras in later for camera in cameras} == {0, 1, 2, 3}
    assert isinstance(rare.policy, EveryOther)


def test_cameras_of_the_warm_up_are_no_measure_of_what_a_policy_selects() -> None:
    """An overloaded edge takes turns with so many: all of them would be more load, not less."""
    load = Load()
    for awake in [None] * 20 + [1.0] * 20:
        load = after_work(load, 0.0, INTERVAL_S, awake)
        assert load.awake == 1.0
