"""Spells: how long something is so, with hysteresis."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Spell:
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
    """When a spell begins and ends.

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
    """The spells after a slot, and which of them are told now: those begun, those ended."""

    spells: Mapping[Key, Spell]
    begun: Mapping[Key, Spell]
    ended: Mapping[Key, Spell]


def turn(
    spells: Mapping[Key, Spell], values: Mapping[Key, float], time_ns: int, bounds: Bounds
) -> Turned[Key]:
    """Advance spells by a slot.

    Args:
        spells: before it.
        values: how much each is so now; what is not there is not so.
        time_ns: of the slot.
        bounds: when they begin and end.
    """
    after: dict[Key, Spell] = {}
    begun: dict[Key, Spell] = {}
    ended: dict[Key, Spell] = {}
    for key in {**spells, **values}:
        value, spell = values.get(key, 0.0), spells.get(key)
        if spell is None:
            if value >= bounds.on:
                spell = Spell(time_ns, time_ns, value)
        elif value >= bounds.off:
            spell = replace(spell, held_ns=time_ns, most=max(spell.most, value))
        elif time_ns - spell.held_ns >= bounds.ends_s * 1e9:
            if spell.told:
                ended[key] = spell
            spell = None
        if spell is None:
            continue
        if not spell.told and spell.held_ns - spell.since_ns >= bounds.after_s * 1e9:
            spell = replace(spell, told=True)
            begun[key] = spell
        after[key] = spell
    return Turned(after, begun, ended)
