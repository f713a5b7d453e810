"""Views wait for their slot; what is late is counted."""

from __future__ import annotations

import threading

import numpy as np
from tests.manual_clock import ManualClock

from e3pose.edge.gather import MAX_AHEAD_SLOTS, Arrival, Gather
from e3pose.model.pose import Poses2D
from e3pose.runtime.clock import WallClock


def arrival(x: float = 1.0) -> Arrival:
    return Arrival(Poses2D(np.full((1, 1, 2), x), np.ones((1, 1))), 0, 0)


def test_slot_gets_its_views_and_no_others() -> None:
    gather = Gather(3)
    assert gather.add(0, 1, arrival()) and gather.add(1, 2, arrival())
    assert set(gather.close()) == {1}
    assert set(gather.close()) == {2}
    assert set(gather.close()) == set()


def test_late_view_is_counted_and_refused() -> None:
    gather = Gather(2)
    gather.close()
    assert not gather.add(0, 1, arrival())
    assert gather.late.tolist() == [0, 1]


def test_age_of_late_views_is_that_of_the_oldest() -> None:
    gather = Gather(2)
    gather.close()
    for age_ns in (200_000_000, 310_000_000, 250_000_000):
        gather.add(0, 1, Arrival(arrival().poses, 5, 5 + age_ns))
    np.testing.assert_allclose(gather.late_by_s(), [np.nan, 0.31])


def test_view_of_the_far_future_is_refused() -> None:
    gather = Gather(2)
    assert gather.add(MAX_AHEAD_SLOTS, 0, arrival())
    assert not gather.add(MAX_AHEAD_SLOTS + 1, 0, arrival())
    assert gather.late.tolist() == [0, 0]


def test_newer_view_of_a_slot_counts() -> None:
    gather = Gather(2)
    gather.add(0, 0, arrival(1.0))
    gather.add(0, 0, arrival(2.0))
    assert gather.close()[0].poses.keypoints_px[0, 0, 0] == 2.0


def test_waits_only_for_cameras_that_are_wanted() -> None:
    gather = Gather(2)
    gather.add(0, 0, arrival())
    assert gather.missing([0, 1]) == [1]
    assert gather.missing([0]) == []
    assert gather.missing([]) == []


def test_skipped_slots_are_forgotten() -> None:
    gather = Gather(1)
    for slot in range(10):
        gather.add(slot, 0, arrival(slot))
    gather.skip_to(8)
    assert gather.close()[0].poses.keypoints_px[0, 0, 0] == 8
    gather.skip_to(2)  # time does not run backwards
    assert gather.slot == 9


def test_sleeper_is_woken_by_a_view_of_its_slot() -> None:
    gather, clock = Gather(1), WallClock()
    threading.Timer(0.005, lambda: gather.add(0, 0, arrival())).start()
    while missing := gather.missing([0]):
        gather.sleep(clock, clock.now_ns() + 10**9, missing)
    assert set(gather.close()) == {0}


def test_nobody_sleeps_once_the_views_that_are_awaited_are_here() -> None:
    naps, clock = Naps(), ManualClock(1000)
    gather = Gather(3, _lock=naps)
    gather.add(0, 0, arrival())
    gather.sleep(clock, 10**12, [0])
    assert naps.seconds == []
    gather.sleep(clock, 10**12, [0, 1])
    assert len(naps.seconds) == 1


def test_sleeper_is_woken_by_the_last_view_that_is_awaited() -> None:
    naps, clock = Naps(), ManualClock(1000)
    gather = Gather(3, _lock=naps)
    gather.sleep(clock, 10**12, [0, 1])
    gather.add(0, 0, arrival())
    gather.add(1, 1, arrival())
    assert naps.woken == 0
    gather.add(0, 1, arrival())
    assert naps.woken == 1


class Naps(threading.Condition):
    """A condition that notes how long somebody wants to wait, and does not, and who is woken."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: list[float | None] = []
        self.woken = 0

    def wait(self, timeout: float | None = None) -> bool:
        self.seconds.append(timeout)
        return False

    def notify_all(self) -> None:
        self.woken += 1


def test_nobody_sleeps_past_the_deadline() -> None:
    naps, clock = Naps(), ManualClock(1000)
    gather = Gather(1, _lock=naps)
    gather.sleep(clock, 1000)
    gather.sleep(clock, 0)
    assert naps.seconds == []
    gather.sleep(clock, 1000 + 2_000_000)
    assert naps.seconds == [0.002]


def test_sleeper_looks_again_long_before_a_far_deadline() -> None:
    naps, clock = Naps(), ManualClock(1000)
    Gather(1, _lock=naps).sleep(clock, 10**12)
    assert len(naps.seconds) == 1 and naps.seconds[0] is not None
    assert 0 < naps.seconds[0] <= 0.05
