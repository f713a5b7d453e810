"""Rules by the kind of event that they tell. A new one is a file, a line here, its test.

One's own comes in by its name, as policies do: an entry point of the group `e3pose.events`, or
`module:name`. It is a class, or a function that takes the settings and the skeleton's joints.
"""

from __future__ import annotations

from collections.abc import Callable

from e3pose.base.errors import InputError
from e3pose.base.plugins import maker
from e3pose.events.body import Joints
from e3pose.events.rules.base import Rule as Rule
from e3pose.events.rules.base import Snapshot as Snapshot
from e3pose.events.rules.base import inherited as inherited
from e3pose.events.rules.fall import Fall, GotUp, OnFloor
from e3pose.events.rules.presence import Left, nobody_seen, too_many
from e3pose.events.rules.wave import Waved
from e3pose.settings.events_table import EventsTable

GROUP = "e3pose.events"
RULES: dict[str, Callable[[EventsTable, Joints], Rule]] = {
    "fall": lambda table, joints: Fall(table),
    "on-floor": lambda table, joints: OnFloor(table),
    "got-up": lambda table, joints: GotUp(table),
    "left": lambda table, joints: Left(table),
    "nobody": lambda table, joints: nobody_seen(table),
    "too-many": lambda table, joints: too_many(table),
    "waved": lambda table, joints: Waved(joints),
}


def make_rules(table: EventsTable, joints: Joints) -> dict[str, Rule]:
    """Return the rules that a site asks for.

    Raises:
        InputError: for a kind that is not known, or that two rules would tell.
    """
    rules: dict[str, Rule] = {}
    for name in table.kinds or RULES:
        kind = kind_of(name)
        if kind in rules:
            raise InputError("kinds", repr(name[:80]), f"one rule for {kind}")
        rules[kind] = maker(GROUP, "kinds", name, RULES)(table, joints)
    for kind in table.urgent:
        if kind not in {**RULES, **rules}:
            listed = ", ".join({**RULES, **rules})
            raise InputError("urgent", repr(kind[:40]), f"some of {listed}")
    return rules


def kind_of(name: str) -> str:
    """Return the kind that a rule tells: its name, of `module:name` the part after the colon."""
    return name.rpartition(":")[2]
