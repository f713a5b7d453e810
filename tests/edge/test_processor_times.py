"""Processor time of live cameras from heartbeats, and slots per second of a machine that runs."""

from __future__ import annotations

import pytest
from tests.cases import each_case

from e3pose.edge.counters import SUSPENDED_S, Counts
from e3pose.edge.processor_times import ProcessorTimes
from e3pose.recording import ProcessorTime
from e3pose.wire.messages import Heartbeat

SLOTS_PER_S = 10.0


def beat(at_s: float, looks: int, session: int = 1, asleep_s: float = 0.0) -> Heartbeat:
    """Return a heartbeat of a camera that takes 0.1 s a look, and 0.02 s for each awake slot."""
    awake_s = at_s - asleep_s
    return Heartbeat(
        "cam1", session, 0, "active", captured=round(3 * awake_s * SLOTS_PER_S), detected=looks,
        active_s=awake_s / 2, idle_s=awake_s / 2, asleep_s=asleep_s,
        cpu_s=0.1 * looks + 0.02 * awake_s * SLOTS_PER_S, look_cpu_s=0.1 * looks,
    )  # fmt: skip


def took(*beats: Heartbeat) -> dict[str, ProcessorTime]:
    times = ProcessorTimes(SLOTS_PER_S)
    for each in beats:
        times.take(each)
    return times.found()


def test_time_of_a_look_and_of_a_slot_is_that_between_heartbeats() -> None:
    found = took(beat(5, 40), beat(6, 44), beat(9, 60, asleep_s=1.0))
    assert found["cam1"].look_s == pytest.approx(0.1)
    assert found["cam1"].frame_s == pytest.approx(0.02)  # though it captures thrice a slot
    assert found["cam1"].looks == 20


def test_program_that_starts_again_adds_up() -> None:
    found = took(beat(5, 40), beat(6, 50), beat(0.5, 1, session=2), beat(2.5, 11, session=2))
    assert found["cam1"].looks == 20 and found["cam1"].frame_s == pytest.approx(0.02)


def test_too_little_says_nothing_and_each_recording_has_its_own() -> None:
    assert took(beat(5, 40)) == {} and took(beat(5, 40), beat(6, 42)) == {}
    times = ProcessorTimes(SLOTS_PER_S)
    for each in (beat(5, 40), beat(6, 50)):
        times.take(each)
    assert times.found()["cam1"].looks == 10
    times.take(beat(8, 60))
    assert times.found()["cam1"].looks == 10 and times.found() == {}


def test_camera_that_does_not_say_what_it_took_is_left_out() -> None:
    silent = [Heartbeat("cam1", 1, 0, "active", detected=n, active_s=n) for n in (0, 50)]
    assert took(*silent) == {}


INTERVAL_S = 0.04


@each_case(("away_s", "fps"), [(SUSPENDED_S, 25.0), (600.0, 25.0), (10.0, 20.0)])
def test_suspended_machine_is_not_slow(away_s: float, fps: float) -> None:
    counts = Counts(4, INTERVAL_S, slots=1000, first_ns=5)
    counts.skip(round(away_s / INTERVAL_S))
    now_ns = 5 + round((1000 * INTERVAL_S + away_s) * 1e9)
    assert counts.fps(now_ns) == pytest.approx(fps)
    assert counts.lost == round(away_s / INTERVAL_S)
