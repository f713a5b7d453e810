"""Time by mode: each slot with a look counts once, whenever threads and heartbeats come to it."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case
from tests.energy.meters.trees import GENERIC
from tests.manual_clock import ManualClock

from e3pose.energy.activity import ModeClock
from e3pose.energy.meters.choose import ModelMeter
from e3pose.energy.meters.sampler import PowerSampler
from e3pose.energy.profiles import modes_of

MS = 10**6
SLOT_NS = 40 * MS


def spent_ms(modes: ModeClock) -> dict[str, float]:
    return {mode: ns / MS for mode, ns in modes.times().spent_ns.items()}


@each_case("share", [0.1, 0.25, 0.5, 0.9, 1.0])
def test_slots_with_a_look_count_once_however_punctual_their_frames_are(share: float) -> None:
    rng = np.random.default_rng(3)
    clock, looks = ManualClock(10**18), 0
    modes = ModeClock(clock.now_ns)
    for slot in range(2000):
        clock.time_ns = 10**18 + slot * SLOT_NS + int(rng.uniform(0, 25) * MS)
        if rng.uniform() < share:
            modes.look(clock.now_ns(), SLOT_NS)
            looks += 1
        if rng.uniform() < 0.1:
            modes.times()  # a heartbeat, which may come at any time
    clock.time_ns = 10**18 + 2010 * SLOT_NS
    fields = modes.times().fields()
    assert fields["active_s"] == pytest.approx(looks * 0.04)
    assert fields["active_s"] + fields["idle_s"] == pytest.approx(2010 * 0.04)
    assert fields["mode"] == "power-saving" and fields["asleep_s"] == 0


def test_a_slot_with_a_look_is_active_whole_from_when_its_network_begins() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    clock.advance(1.0)
    moments = [modes.times()]
    for slot in range(50):
        came_ns = clock.now_ns()
        clock.advance(0.005)
        if slot % 2:
            modes.look(came_ns, SLOT_NS)
        assert modes.times().mode == ("active" if slot % 2 else "power-saving")
        clock.advance(0.035)
        moments.append(modes.times())
    for slot, (before, after) in enumerate(pairwise(moments)):
        passed = after.seconds_since(before)
        assert passed.get("active", 0.0) == pytest.approx(0.04 if slot % 2 else 0.0)
        idle_s = after.fields()["idle_s"] - before.fields()["idle_s"]
        assert idle_s == pytest.approx(0.0 if slot % 2 else 0.04, abs=0.0051)


def test_idle_time_never_falls() -> None:
    clock, rng = ManualClock(), np.random.default_rng(1)
    modes = ModeClock(clock.now_ns)
    said_s = []
    for _ in range(2000):  # always active, by a clock that is a little slower than the edge's
        modes.look(clock.now_ns(), SLOT_NS)
        clock.advance(rng.uniform(0.038, 0.0419))
        said_s.append(modes.times().fields()["idle_s"])
    assert all(after >= before for before, after in pairwise(said_s)) and said_s[-1] < 0.05


def test_camera_without_frames_does_not_stay_active() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    modes.look(clock.now_ns(), SLOT_NS)
    assert modes.times().mode == "active"
    clock.advance(3600.0)
    assert modes.times().mode == "power-saving"
    assert spent_ms(modes) == {"active": 40.0, "power-saving": 3_600_000.0 - 40.0}
    assert modes.times().idle_ns == (3_600_000 - 40) * MS


@pytest.mark.parametrize("asleep", ["asleep", "suspended"])
def test_who_falls_asleep_in_an_active_slot_is_asleep_at_once_and_keeps_the_slot(
    asleep: str,
) -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    modes.look(clock.now_ns(), SLOT_NS)
    clock.advance(0.01)
    modes.change(asleep)  # type: ignore[arg-type]
    assert modes.times().mode == asleep
    modes.look(clock.now_ns(), SLOT_NS)  # of a frame that was taken before
    assert modes.times().mode == asleep
    clock.advance(2.0)
    modes.change("power-saving")
    clock.advance(1.0)
    fields = modes.times().fields()
    assert fields["active_s"] == pytest.approx(0.08)
    assert fields["asleep_s"] == pytest.approx(2.0)
    assert fields["idle_s"] == pytest.approx(1.01 - 0.08)


def test_source_closed_between_looks_is_idle_time_of_its_own() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    modes.look(clock.now_ns(), SLOT_NS)
    modes.change("aggressive-power-saving")
    assert modes.times().mode == "active"
    clock.advance(0.1)
    assert modes.times().mode == "aggressive-power-saving"
    assert spent_ms(modes) == {"active": 40.0, "aggressive-power-saving": 60.0, "power-saving": 0.0}
    assert modes.times().fields()["idle_s"] == pytest.approx(0.06)


def test_clock_that_is_set_back_takes_nothing_away() -> None:
    clock = ManualClock(10**18)
    modes = ModeClock(clock.now_ns)
    modes.look(clock.now_ns(), SLOT_NS)
    clock.advance(1.0)
    before = modes.times()
    clock.time_ns -= 3600 * 10**9
    assert modes.times() == before


def test_threads_lose_and_invent_no_time() -> None:
    modes, over = ModeClock(time.monotonic_ns), threading.Event()
    begun, looks = modes.times(), [0, 0]

    def work(number: int) -> None:
        while not over.wait(0.0005):
            modes.look(0, 10_000)
            modes.change("aggressive-power-saving" if number else "power-saving")
            looks[number] += 1

    threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    while sum(looks) < 200:
        modes.times()
    over.set()
    for thread in threads:
        thread.join()
    time.sleep(0.01)  # in which all slots have passed
    taken = modes.times()
    assert taken.spent_ns["active"] == sum(looks) * 10_000
    assert sum(taken.spent_ns.values()) - sum(begun.spent_ns.values()) == taken.at_ns - begun.at_ns


def test_model_adds_up_the_time_in_each_mode_whenever_it_is_read() -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    sampler = PowerSampler(ModelMeter(GENERIC, "a test"), modes)
    sampler()
    for slot in range(1000):
        if slot % 2 == 0:
            modes.look(clock.now_ns(), SLOT_NS)
            clock.advance(0.02)
            sampler.sample()  # always in the middle of an active slot
            clock.advance(0.02)
        else:
            clock.advance(0.04)
    fields = sampler()
    active_w, idle_w = GENERIC.watts("active"), GENERIC.watts("power-saving")
    assert (fields["active_s"], fields["idle_s"]) == pytest.approx((20.0, 20.0))
    assert fields["energy_j"] == pytest.approx(20 * (active_w + idle_w))
    assert fields["power_w"] == pytest.approx((active_w + idle_w) / 2), "since it was asked last"
    clock.advance(0.5)
    assert sampler()["power_w"] == pytest.approx(idle_w)
    modes.change("asleep")
    clock.advance(0.001)
    asleep_w = {rest.name: rest.watts for rest in modes_of(GENERIC).rests}["asleep"]
    assert sampler()["power_w"] == asleep_w, "which it draws until it is heard again"
