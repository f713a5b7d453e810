"""Which looks events are worth: a second camera for what is unsure, few for who lies in bed."""

from __future__ import annotations

from collections.abc import Iterator

from tests.events.bodies import FPS, START_S, doing, seen
from tests.events.test_rules import BED

from e3pose.events.people import Seen
from e3pose.events.watch import CAMERAS, ENOUGH_PER_S, Watch, advance, begin_watch, looks_of
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable


def requests(
    kind: str, table: EventsTable | None = None, zones: tuple[ZoneTable, ...] = ()
) -> Iterator[tuple[float, LookRequest, Watch]]:
    """Yield what is asked for while somebody does something, by seconds since it began."""
    watch = begin_watch(table or EventsTable(), COCO17.joints, zones)
    for slot in seen(doing(kind, 0)):
        watch, _ = advance(watch, slot)
        yield slot.time_ns / 1e9 - START_S, looks_of(watch), watch


def test_who_stands_asks_for_nothing_and_who_falls_for_a_second_camera() -> None:
    found = list(requests("fall-backward"))
    before = [request for at_s, request, _ in found if at_s < 0]
    assert set(before) == {NO_REQUEST}
    asked_s = [at_s for at_s, request, _ in found if request.cameras == CAMERAS]
    down_s = next(at_s for at_s, _, watch in found if watch.shown[1].on_floor > 0.6)
    assert asked_s[0] < down_s
    on_floor = [request for at_s, request, _ in found if down_s < at_s < down_s + 2]
    assert {request.tracks for request in on_floor} == {(1,)}

    # Who lies on for long asks for no more.
    assert found[-1][1] == NO_REQUEST
    later = [request.cameras for at_s, request, _ in found if 4 < at_s - down_s < 5]
    assert set(later) == {0.0}


def test_somebody_in_bed_is_watched_by_few_looks() -> None:
    found = [request for at_s, request, _ in requests("lie-on-bed", zones=(BED,)) if 6 < at_s < 8]
    assert set(found) == {LookRequest(enough_per_s=ENOUGH_PER_S)}


def test_who_was_lost_is_looked_for() -> None:
    watch = begin_watch(EventsTable(), COCO17.joints)
    slots = list(seen(doing("pick-up", 0)))[: round(2 * FPS)]
    for slot in slots:
        watch, _ = advance(watch, slot)
    empty = Seen(slots[-1].slot + 9, slots[-1].time_ns + 10**9, People.empty(17))
    watch, _ = advance(watch, empty)
    assert looks_of(watch) == LookRequest(CAMERAS, (1,))


def test_a_site_that_is_not_to_tell_falls_asks_for_nothing() -> None:
    table = EventsTable(kinds=("waved",))
    assert {request for _, request, _ in requests("fall-left", table)} == {NO_REQUEST}
