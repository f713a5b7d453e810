"""Rules by the kind of event that they tell. A new one is a file, a line here, its test."""

from __future__ import annotations

from collections.abc import Callable

from e3pose.base.errors import InputError
from e3pose.events.body import Joints
from e3pose.events.rules.base import Moment as Moment
from e3pose.events.rules.base import Rule as Rule
from e3pose.events.rules.base import inherited as inherited
from e3pose.events.rules.fall import Fall
from e3pose.events.rules.left import Left
from e3pose.events.rules.on_floor import GotUp, OnFloor
from e3pose.events.rules.presence import nobody, too_many
from e3pose.events.rules.wave import Waved
from e3pose.settings.events_table import EventsTable

RULES: dict[str, Callable[[EventsTable, Joints], Rule]] = {
    "fall": lambda table, joints: Fall(table),
    "on-floor": lambda table, joints: OnFloor(table),
    "got-up": lambda table, joints: GotUp(table),
    "left": lambda table, joints: Left(table),
    "nobody": lambda table, joints: nobody(table),
    "too-many": lambda table, joints: too_many(table),
    "waved": lambda table, joints: Waved(joints),
}


def make_rules(table: EventsTable, joints: Joints) -> dict[str, Rule]:
    """Return the rules that a site asks for.

    Raises:
        InputError: for a kind that is not known.
    """
    for key, kinds in (("kinds", table.kinds), ("urgent", table.urgent)):
        for kind in kinds:
            if kind not in RULES:
                raise InputError(key, repr(kind[:40]), f"some of {', '.join(RULES)}")
    return {kind: RULES[kind](table, joints) for kind in table.kinds or RULES}
