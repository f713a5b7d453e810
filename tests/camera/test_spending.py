"""Heartbeats are made between two slots: what was spent is taken before the slot's look."""

from __future__ import annotations

import threading
from typing import Any

from tests.manual_clock import ManualClock
from tests.waiting import eventually

from e3pose.camera.live import SLOT_WAIT_S, Box, Spending, pause_ns
from e3pose.energy.activity import ModeClock

SLOT_NS = 40_000_000


def test_what_was_spent_is_taken_before_the_look_of_the_slot_that_begins() -> None:
    clock, found = ManualClock(), list[dict[str, Any]]()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {"energy_j": clock.now_ns() / 1e9})
    spending.begin_slot(active=True)  # nobody waits
    modes.look(0, SLOT_NS)
    waiting = threading.Thread(target=lambda: found.append(spending.by_next_slot()))
    waiting.start()
    assert eventually(lambda: not spending.told.is_set())
    clock.advance(0.04)
    spending.begin_slot(active=True)
    modes.look(clock.now_ns(), SLOT_NS)
    clock.advance(0.03)
    waiting.join()
    assert found == [
        {"mode": "active", "active_s": 0.04, "idle_s": 0.0, "asleep_s": 0.0, "energy_j": 0.04}
    ]


def test_camera_without_frames_says_what_it_spent_all_the_same() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {})
    modes.change("aggressive-power-saving")
    clock.advance(SLOT_WAIT_S)
    for _ in range(2):
        spent = spending.by_next_slot()
        assert (spent["mode"], spent["idle_s"]) == ("aggressive-power-saving", SLOT_WAIT_S)


def test_times_that_a_meter_took_itself_replace_those_before_it_was_read() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)

    def meter(mode: object) -> dict[str, Any]:
        clock.advance(0.003)
        return {**modes.times().fields(), "energy_j": 1.0}

    assert Spending(modes, meter).now()["idle_s"] == 0.003


def test_nothing_is_taken_while_a_look_goes_on_unless_it_never_ends() -> None:
    clock, looking, found = ManualClock(), [True], list[dict[str, Any]]()
    modes = ModeClock(clock.now_ns)
    spending = Spending(modes, lambda mode: {"energy_j": clock.now_ns() / 1e9}, lambda: looking[0])
    spending.told.clear()
    spending.begin_slot(active=True)
    assert not spending.told.is_set() and not spending._taken
    assert spending.by_next_slot()["energy_j"] == 0.0
    waiting = threading.Thread(target=lambda: found.append(spending.by_next_slot()))
    waiting.start()
    assert eventually(lambda: not spending.told.is_set())
    clock.advance(0.04)
    looking[0] = False
    spending.begin_slot(active=False)
    clock.advance(0.04)
    waiting.join()
    assert [spent["energy_j"] for spent in found] == [0.04]


def test_a_look_goes_on_from_when_its_frame_is_put_until_the_next_is_taken() -> None:
    box = Box[int]()
    assert not box.busy
    box.put(1)
    assert box.busy and box.take() == 1 and box.busy
    taking = threading.Thread(target=box.take)
    taking.start()
    assert eventually(lambda: not box.busy)
    box.close()
    taking.join()


def test_number_of_slots_between_heartbeats_varies() -> None:
    pauses_ns = [pause_ns(draw / 10) for draw in range(10)]
    assert min(pauses_ns) > 0.3e9 and max(pauses_ns) < 0.6e9
    assert max(pauses_ns) - min(pauses_ns) > 3 * SLOT_NS
