"""The lead over simulated delays: back to the need in 20 s, few late orders, no oscillation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.edge.lead import Lead, adapt, starting, take_in_delay, with_edge_delay

pytestmark = pytest.mark.slow

BEAT_S = 0.5  # cameras report the longest delay since their last report
Link = Callable[[float], float]  # delay of an order that leaves at a time
Pauses = tuple[tuple[float, float], ...]  # each from so many seconds to so many


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What happened, slot by slot.

    Attributes:
        times_s: `(num_slots,)` when each slot was.
        leads: `(num_slots,)` of its order.
        late: `(num_slots, num_cameras)` orders that came after the slot they are for had begun.
    """

    times_s: Floats
    leads: NDArray[np.int64]
    late: NDArray[np.bool_]

    def changes(self, start_s: float = 0.0, end_s: float = np.inf) -> int:
        """Return how often the lead changed in a time."""
        return int((np.diff(self.leads[self._within(start_s, end_s)]) != 0).sum())

    def late_share(self, start_s: float = 0.0, end_s: float = np.inf) -> float:
        """Return the share of late orders in a time."""
        return float(self.late[self._within(start_s, end_s)].mean())

    def back_s(self, end_s: float, need: int, until_s: float = np.inf) -> float:
        """Return how long after the end of a disturbance the lead is that needed, to stay."""
        within = self._within(end_s, until_s)
        too_long = np.flatnonzero(self.leads[within] > need)
        return 0.0 if not len(too_long) else float(self.times_s[within][too_long[-1]] - end_s)

    def _within(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        return (self.times_s >= start_s) & (self.times_s < end_s)


def simulated(
    links: Sequence[Link],
    slots_per_s: float,
    seconds: float,
    stalls: Pauses = (),
    pauses: Pauses = (),
    own_s: float = 0.02,
    lead: Lead | None = None,
) -> Simulated:
    """Run the lead of an edge over links whose delays are known.

    Args:
        links: by camera, the delay of an order that leaves at a time.
        slots_per_s: of the edge.
        seconds: how long.
        stalls: of the edge with its whole machine: no order leaves, and no report is read.
        pauses: of every link: orders and reports arrive at the end.
        own_s: from the middle of a slot until its orders leave.
        lead: at the start; by default 4 slots, and the edge has just started.
    """
    interval_s = 1 / slots_per_s
    lead = starting(4) if lead is None else lead
    either = (*pauses, *stalls)
    times_s = np.asarray(np.arange(round(seconds * slots_per_s)) * interval_s, dtype=np.float64)
    leads = np.empty(len(times_s), np.int64)
    late = np.empty((len(times_s), len(links)), bool)
    arrived: list[list[tuple[float, float]]] = [[] for _ in links]  # when, after what delay
    beats = [BEAT_S * (1 + camera / len(links)) for camera in range(len(links))]
    for slot, time_s in enumerate(times_s.tolist()):
        leads[slot] = lead.slots
        left_s = _resumed(time_s + own_s, stalls)
        for camera, delay_of in enumerate(links):
            came_s = _resumed(left_s + delay_of(left_s), either)
            arrived[camera].append((came_s, came_s - time_s))
            late[slot, camera] = came_s - time_s > (lead.slots - 0.5) * interval_s
        lead = with_edge_delay(lead, left_s - time_s - own_s, interval_s)
        for camera in range(len(links)):
            while (beat_s := _resumed(beats[camera], either)) <= left_s:
                said = [delay_s for came_s, delay_s in arrived[camera] if came_s <= beat_s]
                arrived[camera] = [order for order in arrived[camera] if order[0] > beat_s]
                beats[camera] = beat_s + BEAT_S
                if said:
                    lead = take_in_delay(lead, camera, max(said))
        lead = adapt(lead, interval_s)
    return Simulated(times_s, leads, late)


def _resumed(time_s: float, pauses: Pauses) -> float:
    """Return when something goes on that was due at a time."""
    if not pauses:
        return time_s
    return max((end_s for start_s, end_s in pauses if start_s <= time_s < end_s), default=time_s)


def steady(delay_s: float) -> Link:
    """Return a link with a constant delay."""
    return lambda time_s: delay_s


def during(start_s: float, end_s: float, disturbed_s: float, delay_s: float) -> Link:
    """Return a link whose delay is another one in a time."""
    return lambda time_s: disturbed_s if start_s <= time_s < end_s else delay_s


def wireless(seed: int, median_s: float = 0.02, spread: float = 0.8) -> Link:
    """Return a link with lognormal delays: at 0.8, one in a hundred is six times the median."""
    rng = np.random.default_rng(seed)
    draws = (draw for _ in itertools.count() for draw in rng.standard_normal(1024).tolist())
    return lambda time_s: median_s * math.exp(spread * next(draws))


BACK_S = 20.0
DELAY_S, OWN_S = 0.02, 0.03  # of a link; from the middle of a slot until its orders leave
SITE = (steady(DELAY_S),) * 3
RATES = each_case("rate", [6.0, 12.5, 25.0])


def need(rate: float, delay_s: float = DELAY_S) -> int:
    """The least lead at which orders come a tenth of a slot before theirs begins."""
    return max(math.ceil((delay_s + OWN_S) * rate + 0.6 - 1e-9), 1)


def run(rate: float, *links: Link, seconds: float = 120.0, **more: object) -> Simulated:
    return simulated(links or SITE, rate, seconds, own_s=OWN_S, **more)  # type: ignore[arg-type]


@RATES
@each_case("long_s", [2.0, 10.0])
def test_delays_of_the_start_are_forgotten(rate: float, long_s: float) -> None:
    found = run(rate, *(during(0, long_s, 1.9, DELAY_S),) * 3)
    assert found.back_s(long_s, need(rate)) <= BACK_S
    assert found.late_share(long_s + 2.0) == 0.0
    assert found.changes(long_s + BACK_S) == 0


@RATES
@each_case("long_s", [0.4, 1.0, 2.0, 5.0, 30.0])
def test_stall_of_the_edge_does_not_move_the_lead(rate: float, long_s: float) -> None:
    found = run(rate, stalls=((60, 60 + long_s),))
    assert found.changes(BACK_S) == 0 and found.leads[-1] == need(rate)
    assert found.late_share(60 + long_s) == 0.0


@RATES
def test_short_pauses_of_the_links_do_not_move_the_lead(rate: float) -> None:
    found = run(rate, seconds=300, pauses=tuple((60.0 * k, 60.0 * k + 1) for k in range(1, 5)))
    assert found.changes(BACK_S) == 0 and found.leads[-1] == need(rate)
    assert found.late_share() <= 4 * 1 / 300 + 1e-3


@RATES
@each_case("disturbed_s", [0.06, 0.15, 0.5, 1.9])
def test_lead_is_back_soon_after_slow_links(rate: float, disturbed_s: float) -> None:
    """It went from 51 to 5 slots in eight minutes, a slot at a time."""
    found = run(rate, *(during(60, 90, disturbed_s, DELAY_S),) * 3, seconds=150)
    assert found.leads[found.times_s < 90][-1] == max(need(rate, disturbed_s), need(rate))
    assert found.back_s(90, need(rate)) <= BACK_S
    assert found.late_share(62.5 + disturbed_s, 90) == 0.0 and found.late_share(90) == 0.0
    assert found.changes(60) <= 8


@RATES
def test_links_that_stay_slower_are_followed_for_good(rate: float) -> None:
    found = run(rate, *(during(60, math.inf, 0.3, DELAY_S),) * 3, seconds=300)
    assert found.leads[-1] == need(rate, 0.3)
    assert found.late_share(62.5) == 0.0 and found.changes(60) == 1


@each_case("rate, spread, seed", [(6.0, 0.5, 0), (12.5, 0.8, 10), (25.0, 1.2, 20)])
def test_links_that_vary_do_not_make_the_lead_oscillate(
    rate: float, spread: float, seed: int
) -> None:
    links = tuple(wireless(seed + camera, spread=spread) for camera in range(3))
    found = run(rate, *links, seconds=900)
    assert found.changes(300) <= 10  # one per minute
    assert found.late_share() <= 0.02


@RATES
def test_lead_is_back_after_one_of_two_links_was_slow(rate: float) -> None:
    found = run(rate, steady(DELAY_S), during(60, 90, 0.45, DELAY_S), seconds=150)
    assert found.leads.max() >= need(rate, 0.45)
    assert found.back_s(90, need(rate)) <= BACK_S
