"""Rules: what is told of simulated bodies, once, and what is not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.events.bodies import FPS, doing, seen

from e3pose.base.arrays import Floats
from e3pose.events.people import Seen
from e3pose.events.rules.wave import turns_of
from e3pose.events.watch import advance, begin_watch
from e3pose.model.people import People
from e3pose.model.person_event import PersonEvent, sentence
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable
from e3pose.simulate.episodes import BED_M

EVERYWHERE = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))
BED = ZoneTable("bed", EVERYWHERE, height_m=BED_M)


def told(
    slots: Iterable[Seen], table: EventsTable | None = None, zones: tuple[ZoneTable, ...] = ()
) -> list[PersonEvent]:
    """Return all events of some slots."""
    watch, found = begin_watch(table or EventsTable(), COCO17.joints, zones), list[PersonEvent]()
    for slot in slots:
        watch, events = advance(watch, slot)
        found += events
    return found


def renumbered(slot: Seen, track: int) -> Seen:
    return replace(slot, people=replace(slot.people, track_ids=np.array([track])))


def both(one: Seen, joints_m: Floats, at: Seen | None = None) -> Seen:
    """Return a slot, or that of `at`, with somebody beside the one: tracks 1 and 2."""
    two_m = np.concatenate([one.people.joints_m, joints_m])
    people = People(np.array([1, 2]), two_m, sigma_m=np.concatenate([one.people.sigma_m] * 2))
    return replace(at or one, people=people)


def kinds(events: Iterable[PersonEvent]) -> list[str]:
    """Return which events were told."""
    return [event.kind for event in events]


def lasted_s(event: PersonEvent) -> float:
    """Seconds from its start until it was told."""
    return (event.time_ns - event.start_ns) / 1e9


@each_case(
    "kind, seed",
    [
        ("fall-forward", 0), ("fall-forward", 1), ("fall-backward", 1), ("fall-left", 0),
        ("fall-right", 1), ("fall-from-chair", 0),
    ],
)  # fmt: skip
def test_a_fall_is_told_once_and_so_is_getting_up(kind: str, seed: int) -> None:
    events = told(seen(doing(kind, seed)))
    assert kinds(events) == ["fall", "got-up"]
    fall = events[0]
    assert fall.phase == "begun" and fall.score > 0.5 and 1.9 < lasted_s(fall) < 3.5
    assert sentence(replace(fall, name="Ada")).startswith("Ada fell at 00:00")


@pytest.mark.parametrize("last", [2, 3])
def test_a_fall_is_told_of_somebody_whom_a_second_number_shows_already(
    last: int,
) -> None:
    slots = list(seen(doing("fall-right", 0)))
    (fall, *_) = told(slots)
    changed, upright = list[Seen](), slots[0]
    for slot in slots:
        down_s = (slot.time_ns - fall.start_ns) / 1e9
        if down_s < -0.1:
            changed.append(slot)
            upright = slot
        elif down_s < 0.1:  # the first is still expected to stand
            changed.append(both(upright, slot.people.joints_m, slot))
        else:
            changed.append(renumbered(slot, 2 if down_s < 0.3 else last))
    events = told(changed)
    assert kinds(events) == ["fall", "got-up"] and {event.first for event in events} == {1}


@pytest.mark.parametrize("later_s", [1.0, 3.0])
def test_a_fall_is_told_once_of_somebody_whose_number_changes_on_the_floor(later_s: float) -> None:
    slots = list(seen(doing("fall-left", 0)))
    (fall, *_) = told(slots)
    number = [1 if slot.time_ns < fall.start_ns + later_s * 1e9 else 8 for slot in slots]
    changed = [renumbered(slot, track) for slot, track in zip(slots, number, strict=True)]
    events = told(changed, EventsTable(lies_s=4.0))
    assert kinds(events) == ["fall", "on-floor", "on-floor", "got-up"]
    assert [event.phase for event in events] == ["begun", "begun", "ended", "ended"]
    assert {event.start_ns for event in events[:3]} == {fall.start_ns}
    assert {event.first for event in events} == {1}, "whatever the number is now"


@each_case("kind", ["sit-hard", "kneel", "tie-shoes", "pick-up", "squat", "jump", "crawl"])
@each_case("seed", [0])
def test_what_is_no_fall_is_not_told(kind: str, seed: int) -> None:
    assert told(seen(doing(kind, seed))) == []


def test_a_slow_slide_that_ends_lying_is_a_fall_and_lying_down_as_slowly_is_none() -> None:
    slides = [told(seen(doing("slide-down", seed))) for seed in range(2)]
    lies = [told(seen(doing("lie-on-floor", seed))) for seed in range(2)]
    sits = [told(seen(doing("sit-on-floor", seed))) for seed in range(2)]
    assert any(kinds(events)[:1] == ["fall"] for events in slides), "the others end upright"
    assert not any("fall" in kinds(events) for events in (*lies, *sits))


def test_somebody_who_gets_up_at_once_has_not_fallen() -> None:
    assert "fall" not in kinds(told(seen(doing("play", 0))))


def test_lying_long_is_told_however_it_came_about() -> None:
    events = told(seen(doing("sit-on-floor", 0, stays_s=30.0, seconds=60.0)))
    begun, ended, up = events
    assert (begun.kind, begun.phase, ended.phase) == ("on-floor", "begun", "ended")
    assert up.kind == "got-up"
    assert 20 <= lasted_s(begun) < 21 and lasted_s(ended) > 30


def test_leaving_a_bed_is_told_after_a_stay() -> None:
    slots = list(seen(doing("lie-on-bed", 0, stays_s=14.0, seconds=40.0)))
    assert kinds(told(slots, zones=(BED,))) == ["left"]
    short = EventsTable(settled_s=100.0)
    assert told(slots, short, (BED,)) == []


def test_a_fall_of_a_track_that_changes_its_number_is_told() -> None:
    slots = list(seen(doing("fall-forward", 1)))

    def renamed() -> Iterator[Seen]:
        for slot in slots:
            if 40 <= slot.slot < 60:  # lost while falling
                yield replace(slot, people=slot.people[:0])
            else:
                yield renumbered(slot, 1 + (slot.slot >= 60))

    events = told(renamed())
    assert kinds(events)[0] == "fall" and events[0].track == 2


def test_nobody_and_too_many() -> None:
    table = EventsTable(nobody_s=5.0, most_people=1)
    empty = [Seen(n, round(n / FPS * 1e9), People.empty(17)) for n in range(100)]
    events = told(empty, table)
    assert [(event.kind, event.phase, event.track) for event in events] == [("nobody", "begun", -1)]
    assert told(empty) == []
    two = [both(slot, slot.people.joints_m + 2) for slot in seen(doing("kneel", 0))]
    assert "too-many" in kinds(told(two, table))


def test_waves_are_counted_by_their_turns() -> None:
    def way(*aside_m: float) -> tuple[tuple[int, float], ...]:
        return tuple(enumerate(aside_m))

    assert turns_of(way(0, 0.2, 0, 0.2, 0)) == 3
    assert turns_of(way(0, 0.05, 0, 0.05, 0)) == 0
    assert turns_of(()) == 0


def test_an_older_slot_changes_nothing() -> None:
    slots = list(seen(doing("fall-forward", 0)))
    watch = begin_watch(EventsTable(), COCO17.joints)
    watch, _ = advance(watch, slots[50])
    assert advance(watch, slots[3]) == (watch, [])
