"""Every rule, and one's own, keeps to its Protocol: pure, by its own kind, also where nobody is."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.events.bodies import doing, seen
from tests.events.test_rules import BED
from tests.site.web.watched import RIG, SITE

from e3pose.base.errors import InputError
from e3pose.events.body import joints_of
from e3pose.events.people import Persons, Seen, follow
from e3pose.events.rules import RULES, Snapshot, inherited, kind_of
from e3pose.events.watch import advance, begin_watch, site_watch
from e3pose.model.people import People
from e3pose.model.person_event import ONCE, PersonEvent
from e3pose.model.skeleton import COCO17, SKELETONS
from e3pose.recording.calibration import save_rig
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import ZoneTable

EXAMPLE = Path(__file__).parents[2] / "examples" / "10_own_event.py"
OWN = f"{EXAMPLE}:crouches"
NAMES = [*RULES, OWN]
DONE = ("fall-backward", "lie-on-floor", "kneel")


def table_of(*names: str) -> EventsTable:
    return EventsTable(names, nobody_s=2.0, most_people=1, lies_s=4.0, settled_s=4.0)


def moments(slots: Iterable[Seen], zones: tuple[ZoneTable, ...] = ()) -> Iterator[Snapshot]:
    """Yield slots as rules see them."""
    known: Persons = {}
    for slot in slots:
        known, shown = follow(known, slot, joints_of(COCO17.joints), zones)
        yield Snapshot(slot.slot, slot.time_ns, shown, known)


@cache
def days() -> list[list[Snapshot]]:
    """Return people who do some things, alone and two at a time, and nobody for a while."""
    fall, floor, kneel = (list(seen(doing(kind, 1), seed=1)) for kind in DONE)
    empty = [Seen(n, round(n * 8e7), People.empty(17)) for n in range(120)]
    both = []
    for a, b in zip(fall, kneel, strict=True):
        aside = replace(b.people, track_ids=np.array([2]), joints_m=b.people.joints_m + 1.0)
        both.append(replace(a, people=People.joined([a.people, aside], 17)))
    bed = moments(seen(doing("lie-on-bed", 1)), (BED,))
    return [*(list(moments(slots)) for slots in (fall, floor, kneel, empty, both)), list(bed)]


@each_case("name", NAMES, ids=kind_of)
def test_a_rule_is_pure_and_tells_its_own_kind(name: str) -> None:
    kind, told = kind_of(name), list[PersonEvent]()
    watch = begin_watch(table_of(name), COCO17.joints)
    (rule,) = watch.rules.values()
    assert list(watch.rules) == [kind]
    for day in days():
        memory, open_since = rule.begin(), dict[int, int]()
        for moment in day:
            kept = copy.deepcopy(memory)
            after, events = rule.advance(memory, moment)
            assert memory == kept, "what it was given is changed"
            assert rule.advance(memory, moment) == (after, events), "it remembers by itself"
            assert inherited(after, {}) == after, "a number that changes loses it"
            for event in events:
                assert event.kind == kind and 0 <= event.score <= 1 and event.says
                assert event.start_ns <= event.time_ns == moment.time_ns
                if event.phase == "begun":
                    assert event.track not in open_since or kind == "fall"
                    open_since[event.track] = event.start_ns
                elif kind not in ONCE:
                    assert open_since.pop(event.track) == event.start_ns
            told += events
            memory = after
    if kind != "waved":
        assert told, "none of this day was told"


@each_case("skeleton", sorted(SKELETONS))
def test_all_rules_take_every_skeleton_and_people_without_joints(skeleton: str) -> None:
    joints = SKELETONS[skeleton].joints
    watch = begin_watch(table_of(*NAMES), joints)
    for n in range(60):
        hidden = np.full((2, len(joints), 3), np.nan)
        hidden[0, :2] = 1.0
        people = People(np.array([1, 2]), hidden, sigma_m=np.full(hidden.shape[:2], 0.02))
        shown = Seen(n, n * 10**8, people)
        watch, events = advance(watch, shown)
        assert {event.kind for event in events} <= {"too-many"}


def test_a_rule_of_ones_own_beside_the_site_file_is_used(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(EXAMPLE.read_text())
    save_rig(RIG, tmp_path / "rig.toml")
    place = tmp_path / "site.toml"
    place.write_text(SITE + '[events]\nkinds = ["fall", "mine:crouches"]\nurgent = ["crouches"]\n')
    watch = site_watch(resolve_site(place))
    assert watch is not None and list(watch.rules) == ["fall", "crouches"]
    found = []
    for slot in seen(doing("kneel", 1)):
        watch, events = advance(watch, slot)
        found += [(event.kind, event.phase) for event in events]
    assert found == [("crouches", "begun"), ("crouches", "ended")]


def test_a_rule_of_a_package_is_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    made = EntryPoint("sinks", f"{__name__}:sinks", "e3pose.events")
    points: Mapping[str, list[EntryPoint]] = {"e3pose.events": [made]}
    monkeypatch.setattr("e3pose.base.plugins.entry_points", lambda group: points.get(group, []))
    assert list(begin_watch(EventsTable(("sinks",)), COCO17.joints).rules) == ["sinks"]


def sinks(table: EventsTable, joints: Any) -> Any:
    """Return a rule, as a package may offer it."""
    return RULES["on-floor"](table, joints)


@each_case(
    ("kinds", "said"),
    [
        (("flying",), r"kinds: found 'flying', expected one of fall, .*, or module:Name"),
        (("nowhere:flies",), "kinds: found 'nowhere:flies', but No module named 'nowhere'"),
        ((f"{EXAMPLE}:fall",), "kinds: found no fall in"),
        ((OWN, OWN), "expected one rule for crouches"),
    ],
)
def test_what_is_no_rule_is_refused(kinds: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        begin_watch(EventsTable(kinds), COCO17.joints)
