"""Follow people from slot to slot and tell events: a value that `advance` takes and returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from e3pose.base.errors import InputError, reason_of
from e3pose.events.body import Joints, joints_of
from e3pose.events.people import Person, Persons, Seen, follow, heirs_in
from e3pose.events.rules import Rule, Snapshot, inherited, make_rules
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable

if TYPE_CHECKING:
    from e3pose.settings.resolved import ResolvedSite


EVERY_S = 0.07


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """The memory of the people of a site.

    Attributes:
        joints: of the skeleton.
        zones: of the site.
        rules: which events are told, by kind.
        memories: what each rule remembers.
        known: people who are or were there in the last seconds.
        shown: those of the newest slot.
        slot: the newest.
        time_ns: when people were followed last.
        faults: by kind, why a rule failed in the newest slot; the others go on.
    """

    joints: Joints
    zones: tuple[ZoneTable, ...]
    rules: Mapping[str, Rule]
    memories: Mapping[str, Any]
    known: Persons
    shown: Persons
    slot: int = -1
    time_ns: int = 0
    faults: Mapping[str, str] = field(default_factory=dict)


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
    """Return the watch of a site's people; None where the site does not ask for it.

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
    memories, events, faults = dict[str, Any](), list[PersonEvent](), dict[str, str]()
    for kind, rule in watch.rules.items():
        before = inherited(watch.memories[kind], heirs) if heirs else watch.memories[kind]
        try:
            memories[kind], told = rule.advance(before, snapshot)
        except Exception as error:  # one's own rules may do anything
            memories[kind], told = before, []
            faults[kind] = f"{type(error).__name__}: {reason_of(error)[:200]}"
        events += told
    now = replace(
        watch, memories=memories, known=known, shown=shown, slot=seen.slot, time_ns=seen.time_ns,
        faults=faults,
    )  # fmt: skip
    return now, events


# Which looks the events of a site are worth: what the planner is asked for.
#
# Of somebody who sinks, is just down or was lost, it is unsure whether they fall: that is worth a
# second camera at once. Everybody who is known lies on a bed or a sofa: a few looks a second are
# enough, and cameras rest.

CAMERAS = 2.0  # definition: a second camera
# Looks a second while everybody lies: who rolls off a bed is down half a second later, and two
# looks show it; more are spent on people who sleep.
ENOUGH_PER_S = 4.0
# tuned: s, share of the stature | by reasoning: half way down to a fall's least drop, in the time
#   that a fall takes | `home-fall`, seeds 0 to 5, 26 W, with all of `is_unsure`: 25 of 29 found
#   and not 22
WITHIN_S, SINKS = 0.8, 0.08
# Probability of being on the floor from which on a fall is possible, a third of what `rules.fall`
# begins one with: a larger one asks for looks when it is decided, a smaller one for whoever sits.
PERHAPS_DOWN = 0.2
SURELY_LIES = 0.9  # probability; with less the looks become few while somebody gets up
# Seconds down for which looks are asked: a fall is told after `fall_s`, two by default, and the
# looks before it decide whether it is one; later ones change nothing and take from the budget.
LASTS_S = 3.0


def looks_of(watch: Watch) -> LookRequest:
    """Return the value of looks, from the memory of a site's people."""
    if "fall" not in watch.rules or not watch.known:
        return NO_REQUEST
    unsure = tuple(track for track, one in watch.known.items() if is_unsure(one, watch))
    if unsure:
        return LookRequest(CAMERAS, unsure)
    all_rest = all(rests(person) for person in watch.known.values())
    return LookRequest(enough_per_s=ENOUGH_PER_S) if all_rest else NO_REQUEST


def rests(person: Person) -> bool:
    """Return whether somebody lies on a bed or a sofa."""
    return person.surface_m > 0 and person.lies >= SURELY_LIES


def is_unsure(person: Person, watch: Watch) -> bool:
    """Return whether somebody may fall or may have fallen just now: sinking, down, or lost."""
    if person.track not in watch.shown:
        return True
    if rests(person):
        return False
    if person.on_floor > PERHAPS_DOWN:
        down = watch.memories["fall"].intervals.get(person.track)
        return down is None or watch.time_ns - down.since_ns < LASTS_S * 1e9
    since_ns = watch.time_ns - WITHIN_S * 1e9
    heights = [height for time_ns, height, _ in person.trail if time_ns >= since_ns]
    return len(heights) > 1 and max(heights) - heights[-1] > SINKS
