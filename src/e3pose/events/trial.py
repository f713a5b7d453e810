"""A test in one's own room: what was seen of people, and why no fall was told, in sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from e3pose.base.quantities import plural
from e3pose.events.people import Person, heirs_in
from e3pose.events.rules.fall import why_not
from e3pose.events.states import LYING, STATES, UNKNOWN
from e3pose.events.watch import Watch
from e3pose.model.person_event import NOBODY, PersonEvent
from e3pose.settings.events_table import EventsTable

SETTLED_NS = 1_000_000_000  # a state is said when it has been so for so long
FLOOR_KINDS = ("fall", "on-floor")
DOWN = 0.6  # probability of being on the floor, or lying, that counts
VIEWS_NS = 120_000_000_000  # so long it is remembered which cameras saw something
NOBODY_SEEN = (
    "Nobody was seen. Stand where two cameras see you from head to feet, in light. `e3pose top` "
    "says which cameras are connected, and `e3pose view` draws what each of them finds."
)
NOBODY_DOWN = (
    "Nobody was on the floor. If you lay there: the floor must be at z = 0 and in the pictures, "
    "and a bed or sofa is a zone of its own with a height_m."
)


@dataclass(frozen=True, slots=True)
class Stay:
    """What one person did.

    Attributes:
        seconds: by state.
        said: the state that was said last; empty before the first.
        next: the state that is said once it has settled.
        next_ns: since when it is so.
        down_ns: on the floor since; None while not there.
        floor_s: longest time on the floor.
        raised_s: seconds of lying on a zone with a height.
        why: why the last stay on the floor was told as no fall; empty where it was.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)
    said: str = ""
    next: str = ""
    next_ns: int = 0
    down_ns: int | None = None
    floor_s: float = 0.0
    raised_s: float = 0.0
    why: str = ""


@dataclass(frozen=True, slots=True)
class Told:
    """An event that was told.

    Attributes:
        event: which.
        after_s: from its start until it was published.
        views: slots in between, and in how many a view of each camera came.
    """

    event: PersonEvent
    after_s: float
    views: tuple[int, Mapping[str, int]]


@dataclass(frozen=True, slots=True)
class Trial:
    """What was seen so far.

    Attributes:
        stays: people who were seen, by track.
        told: events, oldest first.
        begun_ns: time of the first slot; 0 before it.
        time_ns: time of the newest.
        seen_s: how long somebody was seen.
        recent: `(time_ns, cameras)` of the last slots, whose views came.
    """

    stays: Mapping[int, Stay] = field(default_factory=dict)
    told: tuple[Told, ...] = ()
    begun_ns: int = 0
    time_ns: int = 0
    seen_s: float = 0.0
    recent: tuple[tuple[int, tuple[str, ...]], ...] = ()

    def was_told(self, kind: str) -> bool:
        """Return whether an event of a kind was told."""
        return any(one.event.kind == kind for one in self.told)

    @property
    def lasted_s(self) -> float:
        """Seconds from the first slot to the newest."""
        return (self.time_ns - self.begun_ns) / 1e9


def advance(
    trial: Trial,
    watch: Watch,
    events: Sequence[PersonEvent],
    cameras: tuple[str, ...],
    told_ns: int,
) -> tuple[Trial, list[str]]:
    """Return the trial after a slot, and what is to be said of it.

    Args:
        trial: before it.
        watch: after the slot; one that did not change changes nothing.
        events: of the slot.
        cameras: whose views came in the slot.
        told_ns: when the slot was published.
    """
    if trial.recent and trial.recent[0][0] < watch.time_ns - VIEWS_NS:
        kept = tuple(one for one in trial.recent if one[0] >= watch.time_ns - VIEWS_NS // 2)
        trial = replace(trial, recent=kept)
    if watch.time_ns <= trial.time_ns:
        return trial, []
    trial = replace(trial, recent=(*trial.recent, (watch.time_ns, cameras)))
    passed_s = (watch.time_ns - trial.time_ns) / 1e9 if trial.time_ns else 0.0
    stays, lines = dict(trial.stays), list[str]()
    for track, before in heirs_in(watch.shown).items():
        stays[track] = stays.pop(before, Stay())
    for track, person in watch.shown.items():
        stay = _after(stays.get(track, Stay()), person, watch, passed_s)
        if stay.next != stay.said and watch.time_ns - stay.next_ns >= SETTLED_NS:
            stay = replace(stay, said=stay.next)
            lines.append(_doing(person, stay.said, cameras))
        stays[track] = stay
    told = [_told(trial, event, told_ns) for event in events]
    lines += [_sentence(one) for one in told]
    return (
        replace(
            trial,
            stays=stays,
            told=(*trial.told, *told),
            begun_ns=trial.begun_ns or watch.time_ns,
            time_ns=watch.time_ns,
            seen_s=trial.seen_s + passed_s * bool(watch.shown),
        ),
        lines,
    )


def account(trial: Trial, table: EventsTable) -> list[str]:
    """Return what was seen, and what to do where something was not.

    Args:
        trial: when it is over.
        table: of the site.
    """
    if not trial.stays:
        return [NOBODY_SEEN]
    lines = [f"Somebody was seen for {trial.seen_s:.0f} of {trial.lasted_s:.0f} s."]
    for track, stay in sorted(trial.stays.items()):
        if stay.said:
            most = sorted(stay.seconds.items(), key=lambda item: -item[1])
            did = ", ".join(f"{state} {s:.0f} s" for state, s in most if s >= 0.5)
            lines.append(f"Person {track}: {did}.")
    falls = [one for one in trial.told if one.event.kind == "fall"]
    lines += [f"FALL of person {one.event.track}: told {_how(one)}." for one in falls]
    if not falls:
        lines += _not_told(trial, table)
    lies = [one for one in trial.told if one.event.kind == "on-floor" and one.event.is_news]
    lines += [f"LONG LIE of person {one.event.track}: told {_how(one)}." for one in lies]
    longest_s = max(stay.floor_s for stay in trial.stays.values())
    if not lies and longest_s:
        stayed = f"{longest_s:.0f} s on the floor, and lies_s is {table.lies_s:g} s"
        lines.append(f"Long lie: not told ({stayed}).")
    return lines


def _after(stay: Stay, person: Person, watch: Watch, passed_s: float) -> Stay:
    """Return what a person did, with a slot more."""
    state = STATES[int(person.states.argmax())]
    seconds = {**stay.seconds, state: stay.seconds.get(state, 0.0) + passed_s}
    if state != stay.next:
        stay = replace(stay, next=state, next_ns=watch.time_ns)
    stay = replace(stay, seconds=seconds)
    if person.surface_m and person.lies >= DOWN:
        stay = replace(stay, raised_s=stay.raised_s + passed_s)
    if person.on_floor < DOWN:
        return replace(stay, down_ns=None)
    down_ns = watch.time_ns if stay.down_ns is None else stay.down_ns
    floor_s = max(stay.floor_s, (watch.time_ns - down_ns) / 1e9)
    memory = watch.memories.get("fall")
    why = stay.why if memory is None else why_not(memory, person)
    return replace(stay, down_ns=down_ns, floor_s=floor_s, why=why)


def _told(trial: Trial, event: PersonEvent, told_ns: int) -> Told:
    """Return an event with how long it took to be told, and by which views."""
    since = [cameras for time_ns, cameras in trial.recent if time_ns >= event.start_ns]
    counts = Counter(camera for cameras in since for camera in cameras)
    return Told(event, (told_ns - event.start_ns) / 1e9, (len(since), dict(sorted(counts.items()))))


def _doing(person: Person, state: str, cameras: Sequence[str]) -> str:
    """Return what a person does now."""
    if state == STATES[UNKNOWN]:
        does = "is seen, but too little of the body to say what they do"
    else:
        sure = f"{100 * float(person.states[STATES.index(state)]):.0f} %"
        place = " on the floor" if person.on_floor >= DOWN else ""
        raised = state == STATES[LYING] and person.surface_m > 0
        place = f" on {person.near or 'a zone'}, not on the floor" if raised else place
        does = f"is {state}{place} ({sure})"
    views = f"; views of {', '.join(cameras)}" if cameras else "; no view came in this slot"
    return f"Person {person.track} {does}{views}"


def _sentence(one: Told) -> str:
    event = one.event
    who = "" if event.track == NOBODY else f"Person {event.track} "
    return f"{event.kind.upper()} {event.phase}: {who}{event.says}, told {_how(one)}"


def _how(one: Told) -> str:
    slots, views = one.views
    with_views = ", ".join(f"{name} in {count}" for name, count in views.items())
    seen = f"with views of {with_views} of {plural(slots, 'slot')}" if views else "without a view"
    since = "going down" if one.event.kind in FLOOR_KINDS else "it began"
    return f"{one.after_s:.1f} s after {since} (score {one.event.score:.2f}), {seen}"


def _not_told(trial: Trial, table: EventsTable) -> list[str]:
    """Return why no fall was told."""
    if table.kinds and "fall" not in table.kinds:
        return ["Fall: not told, because [events] of the site file does not list it in kinds."]
    down = {track: stay for track, stay in trial.stays.items() if stay.floor_s}
    lines = [
        f"Fall: not told. Person {track} was on the floor for {stay.floor_s:.1f} s, but "
        + (
            f"a fall is told after {table.fall_s:g} s (fall_s)"
            if stay.floor_s < table.fall_s
            else stay.why
        )
        + "."
        for track, stay in down.items()
    ]
    if not down:
        lines.append(f"Fall: not told. {NOBODY_DOWN}")
    raised = {track: stay for track, stay in trial.stays.items() if stay.raised_s >= 1}
    return lines + [
        f"Person {track} lay for {stay.raised_s:.0f} s on a zone with a height, which is no floor."
        for track, stay in raised.items()
    ]


def as_json(trial: Trial, sentences: Sequence[str]) -> dict[str, Any]:
    """Return what was seen as JSON can hold it."""
    return {
        "seconds": round(trial.lasted_s, 3),
        "seen_s": round(trial.seen_s, 3),
        "people": [
            {
                "track": track,
                "seconds": {state: round(s, 3) for state, s in stay.seconds.items()},
                "floor_s": round(stay.floor_s, 3),
            }
            for track, stay in sorted(trial.stays.items())
        ],
        "told": [
            {
                "kind": one.event.kind,
                "phase": one.event.phase,
                "track": one.event.track,
                "zone": one.event.zone,
                "score": one.event.score,
                "after_s": round(one.after_s, 3),
                "slots": one.views[0],
                "views": one.views[1],
            }
            for one in trial.told
        ],
        "sentences": list(sentences),
    }
