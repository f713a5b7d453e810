"""Follow people from slot to slot and tell events: a value that `advance` takes and returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from e3pose.base.errors import InputError
from e3pose.events.body import Joints, joints_of
from e3pose.events.people import Persons, Seen, follow, heirs_in
from e3pose.events.rules import Rule, Snapshot, inherited, make_rules
from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable

if TYPE_CHECKING:
    from e3pose.settings.resolved import ResolvedSite

EVERY_S = 0.07


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """What is remembered of the people of a site.

    Attributes:
        joints: of the skeleton.
        zones: of the site.
        rules: which events are told, by kind.
        memories: what each rule remembers.
        known: people who are or were there in the last seconds.
        shown: those of the newest slot.
        slot: the newest.
        time_ns: when people were followed last.
    """

    joints: Joints
    zones: tuple[ZoneTable, ...]
    rules: Mapping[str, Rule]
    memories: Mapping[str, Any]
    known: Persons
    shown: Persons
    slot: int = -1
    time_ns: int = 0


def begin_watch(
    table: EventsTable, joint_names: tuple[str, ...], zones: Sequence[ZoneTable] = ()
) -> Watch:
    """Return a watch before the first slot.

    Raises:
        InputError: for a kind of event that is not known.
    """
    joints = joints_of(joint_names)
    rules = make_rules(table, joints)
    begun = {kind: rule.begin() for kind, rule in rules.items()}
    return Watch(joints, tuple(zones), rules, begun, {}, {})


def site_watch(site: ResolvedSite) -> Watch | None:
    """Return what follows the people of a site; None where it does not ask for it.

    Raises:
        InputError: for a kind of event that is not known.
    """
    if site.file.events is None:
        return None
    try:
        return begin_watch(site.file.events, site.skeleton.joints, site.file.zone)
    except InputError as error:
        raise error.under("events").at(site.file.path) from None


def advance(watch: Watch, seen: Seen) -> tuple[Watch, list[PersonEvent]]:
    """Return the watch after a slot, and its events.

    An older slot than before changes nothing, nor does one that comes within `EVERY_S` of it: what
    people do is slower, and a slot of the edge costs as much as following them.
    """
    soon = watch.slot >= 0 and seen.time_ns - watch.time_ns < EVERY_S * 1e9
    if seen.slot <= watch.slot or soon:
        return watch, []
    known, shown = follow(watch.known, seen, watch.joints, watch.zones)
    heirs = heirs_in(shown)
    snapshot = Snapshot(seen.slot, seen.time_ns, shown, known)
    memories, events = dict[str, Any](), list[PersonEvent]()
    for kind, rule in watch.rules.items():
        before = inherited(watch.memories[kind], heirs) if heirs else watch.memories[kind]
        memories[kind], told = rule.advance(before, snapshot)
        events += told
    now = replace(
        watch, memories=memories, known=known, shown=shown, slot=seen.slot, time_ns=seen.time_ns
    )
    return now, events
