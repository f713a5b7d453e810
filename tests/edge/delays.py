"""Simulated delays of orders, and what the lead makes of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.edge.lead import Lead, adapt, starting, take_in_delay, with_edge_delay

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
