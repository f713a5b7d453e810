"""Intervals in which something is so, with hysteresis."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Interval:
    """Something is so.

    Attributes:
        since_ns: from when on.
        held_ns: when it was so last.
        most: largest value in it.
        told: whether its beginning was told.
    """

    since_ns: int
    held_ns: int
    most: float
    told: bool = False


@dataclass(frozen=True, slots=True)
class Bounds:
    """When an interval begins and ends.

    Attributes:
        on: value from which something is so.
        off: value below which it is no longer.
        after_s: it is told when it has been so for so long.
        ends_s: it ends when it has not been so for so long.
    """

    on: float = 0.6
    off: float = 0.4
    after_s: float = 0.0
    ends_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Turned(Generic[Key]):
    """The intervals after a slot, and which of them are told now: those begun, those ended."""

    intervals: Mapping[Key, Interval]
    begun: Mapping[Key, Interval]
    ended: Mapping[Key, Interval]


def turn(
    intervals: Mapping[Key, Interval], values: Mapping[Key, float], time_ns: int, bounds: Bounds
) -> Turned[Key]:
    """Advance intervals by a slot.

    Args:
        intervals: before it.
        values: how much each is so now; what is not there is not so.
        time_ns: of the slot.
        bounds: when they begin and end.
    """
    after: dict[Key, Interval] = {}
    begun: dict[Key, Interval] = {}
    ended: dict[Key, Interval] = {}
    for key in {**intervals, **values}:
        value, interval = values.get(key, 0.0), intervals.get(key)
        if interval is None:
            if value >= bounds.on:
                interval = Interval(time_ns, time_ns, value)
        elif value >= bounds.off:
            interval = replace(interval, held_ns=time_ns, most=max(interval.most, value))
        elif time_ns - interval.held_ns >= bounds.ends_s * 1e9:
            if interval.told:
                ended[key] = interval
            interval = None
        if interval is None:
            continue
        if not interval.told and interval.held_ns - interval.since_ns >= bounds.after_s * 1e9:
            interval = replace(interval, told=True)
            begun[key] = interval
        after[key] = interval
    return Turned(after, begun, ended)
