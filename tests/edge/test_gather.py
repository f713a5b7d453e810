"""Views wait for their slot; what is late is counted."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np
import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock

from e3pose.edge.gather import MAX_AHEAD_SLOTS, Arrival, Gather
from e3pose.model.pose import Poses2D


def arrival(x: float = 1.0) -> Arrival:
    return Arrival(Poses2D(np.full((1, 1, 2), x), np.ones((1, 1))), 0, 0)


def test_slot_gets_its_newest_views_and_no_others() -> None:
    gather = Gather(3)
    assert gather.add(0, 1, arrival()) and gather.add(1, 2, arrival())
    assert gather.add(0, 1, arrival(2.0))
    first = gather.close()
    assert set(first) == {1} and first[1].poses.keypoints_px[0, 0, 0] == 2.0
    assert set(gather.close()) == {2}
    assert set(gather.close()) == set()
    assert gather.add(3 + MAX_AHEAD_SLOTS, 0, arrival())
    assert not gather.add(4 + MAX_AHEAD_SLOTS, 0, arrival())  # of the far future
    assert gather.late.tolist() == [0, 0, 0]


def test_late_views_are_refused_and_counted_and_their_age_is_that_of_the_oldest() -> None:
    gather = Gather(2)
    gather.close()
    for age_ns in (200_000_000, 310_000_000, 250_000_000):
        assert not gather.add(0, 1, Arrival(arrival().poses, 5, 5 + age_ns))
    assert gather.late.tolist() == [0, 3]
    np.testing.assert_allclose(gather.late_by_s(0.15), [np.nan, 0.31])
    np.testing.assert_allclose(gather.late_by_s(0.4), [np.nan, np.nan])  # not that late


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


def test_sleeper_is_woken_by_the_last_awaited_view_and_nobody_sleeps_once_all_are_here() -> None:
    naps, clock = Naps(), ManualClock(1000)
    gather = Gather(3, _lock=naps)
    gather.sleep(clock, 10**12, [0, 1])
    gather.add(0, 0, arrival())
    gather.add(1, 1, arrival())
    assert naps.woken == 0 and len(naps.seconds) == 1
    gather.sleep(clock, 10**12, [0])
    assert len(naps.seconds) == 1
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


class Arrivals(Naps):
    """Naps that end when the next view comes, and move the clock there."""

    def __init__(self, clock: ManualClock, views: Sequence[tuple[float, int]]) -> None:
        super().__init__()
        self.clock, self.views = clock, list(views)
        self.gather = Gather(3, _lock=self)

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        end_s = self.clock.now_ns() / 1e9 + timeout
        while self.views and self.views[0][0] <= end_s:
            came_s, camera = self.views.pop(0)
            self.clock.time_ns, woken = round(came_s * 1e9), self.woken
            self.gather.add(0, camera, arrival())
            if self.woken > woken:
                return super().wait(timeout)
        self.clock.time_ns = round(end_s * 1e9)
        return super().wait(timeout)


@each_case(
    ("views", "able", "closed_s", "naps", "until_s"),
    [
        ([(1.03, 0), (1.04, 1)], [0, 1], 1.04, 1, 1.045),  # one nap until the last view
        ([(0.996, 0), (0.998, 1)], [0, 1], 1.0, 2, 1.045),  # not before the middle of the slot
        ([(1.03, 0)], [0, 1], 1.045, 1, 1.045),  # the deadline
        ([(1.03, 0)], [0], 1.03, 1, 1.045),  # nobody waits for a camera that is offline
        ([], [], 1.0, 1, 1.045),
        ([(1.04, 0)], [0, 1], 1.04, 2, 1.02),  # no longer than usual for a camera that fails often
        ([(1.01, 0)], [0, 1], 1.02, 1, 1.02),
        ([(1.01, 1), (1.03, 0)], [0, 1], 1.03, 2, 1.02),
    ],
)
def test_slot_closes_with_its_last_view_between_middle_and_deadline(
    views: list[tuple[float, int]], able: list[int], closed_s: float, naps: int, until_s: float
) -> None:
    clock = ManualClock(995_000_000)
    lock = Arrivals(clock, views)
    until_ns = {0: 1_045_000_000, 1: round(until_s * 1e9)}
    stopping = threading.Event()
    assert lock.gather.wait(
        clock,
        stopping,
        1_000_000_000,
        until_ns,
        lambda missing: [camera for camera in missing if camera in able],
    )
    assert clock.now_ns() == pytest.approx(closed_s * 1e9, abs=2)
    assert len(lock.seconds) == naps


def test_nobody_waits_once_the_program_ends() -> None:
    stopping = threading.Event()
    stopping.set()
    assert not Gather(1).wait(ManualClock(), stopping, 10**12, {0: 10**12}, lambda missing: [0])


def test_nobody_sleeps_past_the_deadline_nor_long_before_a_far_one() -> None:
    naps, clock = Naps(), ManualClock(1000)
    gather = Gather(1, _lock=naps)
    gather.sleep(clock, 1000)
    gather.sleep(clock, 0)
    assert naps.seconds == []
    gather.sleep(clock, 1000 + 2_000_000)
    assert naps.seconds == [0.002]
    gather.sleep(clock, 10**12)
    assert naps.seconds[1] is not None and 0 < naps.seconds[1] <= 0.05
