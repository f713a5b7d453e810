"""A test in one's own room: states of people, events, and why no fall was reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from e3pose.events.people import Person, heirs_in
from e3pose.events.rules.fall import why_not
from e3pose.events.states import LYING, STATES, UNKNOWN
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent, who
from e3pose.settings.events_table import EventsTable

SETTLED_NS = 1_000_000_000  # a state is said when it has been so for so long
DOWN = 0.6  # probability of being on the floor, or lying, that counts
NOBODY_SEEN = (
    "Nobody was seen. Stand where two cameras see you from head to feet, in light. `e3pose top` "
    "says which cameras are connected, and `e3pose view` draws what each of them finds."
)
NOBODY_DOWN = (
    "nobody was on the floor. If you lay there: the floor must be at z = 0 and in the pictures, "
    "and a bed or sofa is a zone of its own with a height_m."
)


@dataclass(frozen=True, slots=True)
class Stay:
    """The state of one person: the newest, since when, and the last one printed.

    `down_ns` is since when the person is on the floor; None elsewhere.
    """

    state: str = ""
    since_ns: int = 0
    said: str = ""
    down_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Trial:
    """The test so far: people by track, events, and why no fall was reported."""

    stays: Mapping[int, Stay] = field(default_factory=dict)
    told: tuple[PersonEvent, ...] = ()
    begun_ns: int = 0
    time_ns: int = 0
    why: str = NOBODY_DOWN

    def was_told(self, kind: str) -> bool:
        """Return whether an event of a kind was told."""
        return any(event.kind == kind for event in self.told)


def advance(
    trial: Trial, watch: Watch, events: Sequence[PersonEvent], told_ns: int
) -> tuple[Trial, list[str]]:
    """Return the trial after a slot, and what to print.

    Args:
        trial: before it.
        watch: after the slot.
        events: of the slot.
        told_ns: when the slot was published, nanoseconds since 1970.
    """
    stays, why, lines = dict(trial.stays), trial.why, list[str]()
    for track, before in heirs_in(watch.shown).items():
        stays[track] = stays.pop(before, Stay())
    for track, person in watch.shown.items():
        stay, state = stays.get(track, Stay()), STATES[int(person.states.argmax())]
        if state != stay.state:
            stay = replace(stay, state=state, since_ns=watch.time_ns)
        if state != stay.said and watch.time_ns - stay.since_ns >= SETTLED_NS:
            stay = replace(stay, said=state)
            lines.append(_doing(person, state))
        down = person.on_floor >= DOWN
        down_ns = (stay.down_ns or watch.time_ns) if down else None
        stays[track] = replace(stay, down_ns=down_ns)
        if down_ns is not None:
            why = _why(person, watch, (watch.time_ns - down_ns) / 1e9)
        elif why == NOBODY_DOWN and person.surface_m and person.lies >= DOWN:
            why = f"person {track} lay on a zone with a height, which is no floor."
    lines += [
        f"{event.kind.upper()} {event.phase}: {f'{who(event)} {event.says}'.strip()}, reported "
        f"{(told_ns - event.start_ns) / 1e9:.1f} s after it began (score {event.score:.2f})"
        for event in events
    ]
    told, begun_ns = (*trial.told, *events), trial.begun_ns or watch.time_ns
    return Trial(stays, told, begun_ns, watch.time_ns, why), lines


def account(trial: Trial, table: EventsTable) -> str:
    """Return how the test ended, and what to do if no fall was reported.

    Args:
        trial: when it is over.
        table: of the site.
    """
    if not trial.stays:
        return NOBODY_SEEN
    if trial.was_told("fall") or trial.was_told("on-floor"):
        return "A fall or a long lie was reported."
    if table.kinds and "fall" not in table.kinds:
        return "No fall was reported: [events] of the site file does not list it in kinds."
    return f"No fall was reported: {trial.why}"


def _why(person: Person, watch: Watch, down_s: float) -> str:
    """Return why somebody who is on the floor is not reported as a fall."""
    memory = watch.memories.get("fall")
    reason = "" if memory is None else why_not(memory, person)
    reason = reason or "a fall is reported after fall_s of [events]"
    return f"person {person.track} was on the floor for {down_s:.1f} s, but {reason}."


def _doing(person: Person, state: str) -> str:
    """Return the present activity of a person."""
    if state == STATES[UNKNOWN]:
        return f"Person {person.track} is seen, but too little of the body to say what they do"
    place = " on the floor" if person.on_floor >= DOWN else ""
    if state == STATES[LYING] and person.surface_m > 0:
        place = f" on {person.near or 'a zone'}, not on the floor"
    sure = 100 * float(person.states[STATES.index(state)])
    return f"Person {person.track} is {state}{place} ({sure:.0f} %)"
