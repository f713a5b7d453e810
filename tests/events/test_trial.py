"""A test in one's own room says what was seen, and why no fall was reported."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from tests.cases import each_case
from tests.events.bodies import doing, seen
from tests.events.test_rules import BED

from e3pose.events import watch as watching
from e3pose.events.people import Seen
from e3pose.events.trial import NOBODY_DOWN, NOBODY_SEEN, Trial, account, advance
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable

LATE_NS = 100_000_000


def tried(
    slots: Iterable[Seen], table: EventsTable | None = None, zones: Sequence[ZoneTable] = ()
) -> tuple[Trial, list[str]]:
    """Return what was seen of some slots, and what was said."""
    watch = watching.begin_watch(table or EventsTable(), COCO17.joints, zones)
    trial, said = Trial(), list[str]()
    for slot in slots:
        watch, events = watching.advance(watch, slot)
        trial, lines = advance(trial, watch, events, slot.time_ns + LATE_NS)
        said += lines
    return trial, said


def test_a_fall_is_told_with_its_delay() -> None:
    trial, said = tried(seen(doing("fall-forward", 0)))
    (fall,) = (event for event in trial.told if event.kind == "fall")
    after_s = (fall.time_ns - fall.start_ns + LATE_NS) / 1e9
    assert any("is lying on the floor" in line for line in said)
    (line,) = (line for line in said if line.startswith("FALL begun: Person 1 fell, reported "))
    assert f" {after_s:.1f} s after it began" in line
    assert account(trial, EventsTable()) == "A fall or a long lie was reported."


def test_a_state_is_said_once_when_it_has_settled() -> None:
    _, said = tried(seen(doing("sit-hard", 0)))
    states = [line.split()[3] for line in said if line.startswith("Person")]
    assert states.count("sitting") == 1 and states[0] == states[-1] == "standing"


def test_nobody_seen_says_what_to_do() -> None:
    empty = (
        replace(slot, people=slot.people[:0]) for slot in seen(doing("squat", 0, seconds=24.0))
    )
    trial, said = tried(empty)
    assert account(trial, EventsTable()) == NOBODY_SEEN and not said
    assert trial.time_ns - trial.begun_ns > 20e9


@each_case(
    ("kind", "why"),
    [("lie-on-floor", "slowly"), ("sit-on-floor", "sat there"), ("pick-up", NOBODY_DOWN)],
)
def test_what_is_no_fall_says_why(kind: str, why: str) -> None:
    trial, _ = tried(seen(doing(kind, 1)))
    assert why in account(trial, EventsTable())


def test_lying_on_a_bed_is_said_to_be_no_floor() -> None:
    trial, said = tried(seen(doing("lie-on-bed", 0)), zones=(BED,))
    assert any("lying on bed, not on the floor" in line for line in said)
    assert "is no floor" in account(trial, EventsTable())


@each_case(
    ("table", "why"),
    [
        (EventsTable(fall_s=60.0), "a fall is reported after fall_s"),
        (EventsTable(kinds=("waved",)), "does not list it"),
    ],
)
def test_a_fall_that_is_not_to_be_told_names_the_setting(table: EventsTable, why: str) -> None:
    trial, _ = tried(seen(doing("fall-left", 0)), table)
    assert why in account(trial, table)


def test_a_new_number_is_the_same_person() -> None:
    slots = list(seen(doing("fall-left", 0)))
    late = [
        replace(s, people=replace(s.people, track_ids=s.people.track_ids + 7 * (s.slot > 100)))
        for s in slots
    ]
    trial, _ = tried(late)
    assert set(trial.stays) == {8}
