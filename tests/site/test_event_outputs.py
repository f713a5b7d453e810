"""A fall reaches every output with the fields that the reference of events documents."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.events.bodies import doing, seen
from tests.site.web.watched import STARTED_NS, Watched, poses, record, watched_site
from tests.test_docs import BY_PAGE
from tests.waiting import eventually
from websockets.sync.client import connect as connect_socket

from e3pose.events import watch as watching
from e3pose.events.people import Seen
from e3pose.events.watch import begin_watch, site_watch
from e3pose.model.person_event import PersonEvent, sentence
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import ZoneTable
from e3pose.site.event_sink import EventSink
from e3pose.site.streams.as_json import event_words
from e3pose.site.zones import Zones
from e3pose.store import Run, Store, StoreWriter
from e3pose.wire.arrays import packed_people
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Poses

PAGE = BY_PAGE["docs/reference/events.md"]
TRACK = 7
BEGIN_NS = STARTED_NS + 60 * 10**9
HALL = ZoneTable("hall", ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)))
EVENTS = """[events]
[[zone]]
name = "hall"
corners = [[-2, -2], [2, -2], [2, 2], [-2, 2]]
"""


def listed(text: str, row: str = "") -> set[str]:
    """Return the names in backquotes of the first column of a table, or of one row's second."""
    lines = [line.split("|") for line in text.splitlines() if line.startswith("|")]
    cells = [line[2] for line in lines if row in line[1]] if row else [line[1] for line in lines]
    assert cells
    return {name for cell in cells for name in re.findall(r"`([a-z_]+)`", cell)}


FIELDS = listed(PAGE.partition("## The record of an event")[2].partition("It is the same")[0])


def fallen() -> Iterator[tuple[SlotRecord, int]]:
    """Yield records of somebody who falls at the third second, and their times."""
    for one in seen(doing("fall-forward", 0), track=TRACK):
        made = record(one.slot)
        people = replace(one.people, sigma_m=np.full((1, 17), 0.02))
        yield replace(made, people=people), BEGIN_NS + one.time_ns


def published(slot: SlotRecord, time_ns: int) -> Poses:
    """Return a record as an edge publishes it."""
    usual = poses(slot.slot)
    made = Poses(slot.slot, time_ns, usual.joints, *packed_people(slot.people))
    return msgspec.structs.replace(made, selected=usual.selected, arrived=usual.arrived)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    """A site whose edge keeps a fall as a running one does: by its sink."""
    folder = tmp_path_factory.mktemp("site")
    with watched_site(folder, EVENTS) as made:
        run_of = Run("lab", "lab", BEGIN_NS, 0.08, "coco17", COCO17.joints, ("c0", "c1", "c2"))
        with StoreWriter(folder / "lab.db", run_of) as writer:
            site = resolve_site(folder / "site.toml")
            sink = EventSink(writer, Zones(site.file.zone), site_watch(site))
            for slot, time_ns in fallen():
                sink.append(slot, time_ns=time_ns, wait=True)
        yield made


@pytest.fixture(scope="module")
def fall() -> PersonEvent:
    """The fall as rules tell it."""
    watch, found = begin_watch(EventsTable(), COCO17.joints, (HALL,)), list[PersonEvent]()
    for slot, time_ns in fallen():
        watch, events = watching.advance(watch, Seen(slot.slot, time_ns, slot.people))
        found += [event for event in events if event.kind == "fall"]
    (only,) = found
    assert only.track == TRACK and only.zone == "hall" and only.score > 0.5
    return only


def test_the_record_of_an_event_has_the_fields_that_are_documented(fall: PersonEvent) -> None:
    assert set(event_words(fall)) == FIELDS and {"kind", "start_ns", "sentence"} < FIELDS


def test_it_is_stored(watched: Watched, fall: PersonEvent) -> None:
    (row,) = (r for r in Store(watched.folder / "lab.db").rows("events") if r["kind"] == "fall")
    assert listed(PAGE, "GET /api/events") <= set(row)
    same = ("kind", "phase", "zone", "start_ns", "time_ns")
    assert [row[name] for name in same] == [getattr(fall, name) for name in same]
    assert row["track_id"] == TRACK and row["score"] == pytest.approx(fall.score)
    assert row["message"] == sentence(fall)


def read_csv(path: Path) -> list[dict[str, Any]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@each_case(
    ("form", "read"),
    [
        ("csv", read_csv),
        ("parquet", lambda path: pq.read_table(path).to_pylist()),
        ("json", lambda path: json.loads(path.read_text())),
    ],
)
def test_it_is_queried_and_exported(
    watched: Watched, fall: PersonEvent, tmp_path: Path, form: str, read: Callable[..., Any]
) -> None:
    path = tmp_path / f"events.{form}"
    verb = ("query", watched.folder, "--json") if form == "json" else ("export", watched.folder)
    assert run(*verb, path, "--what", "events") == 0
    (row,) = (one for one in read(path) if one["kind"] == "fall")
    assert listed(PAGE, "query --what events") <= set(row)
    assert int(row["track"]) == TRACK and int(row["start_ns"]) == fall.start_ns
    assert row["message"] == sentence(fall) and row["phase"] == "begun"


def test_it_is_shown_by_the_command(watched: Watched, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("query", watched.folder, "--what", "events") == 0
    assert "Person 7 fell (hall) at" in capsys.readouterr().out


def test_it_is_in_the_api(watched: Watched, fall: PersonEvent) -> None:
    with watched.client() as client:
        rows = client.get("/api/events").json()["rows"]
    (row,) = (one for one in rows if one["kind"] == "fall")
    assert listed(PAGE, "GET /api/events") <= set(row)
    assert row["start_ns"] == fall.start_ns and row["track_id"] == TRACK


def test_followers_of_the_api_are_told(watched: Watched, fall: PersonEvent) -> None:
    for slot, time_ns in fallen():
        watched.edge.publish("e3pose/lab/poses", encode(published(slot, time_ns)))
    assert eventually(lambda: any(one.kind == "fall" for one in watched.view.feed.told))
    url = watched.view.url.replace("http", "ws", 1)
    with connect_socket(f"{url}api/live?format=json") as following:
        said = json.loads(following.recv(10))
        while said["type"] != "told":
            said = json.loads(following.recv(10))
    (told,) = (one for one in said["events"] if one["kind"] == "fall")
    about = BY_PAGE["docs/reference/http-api.md"].partition("A `told` event has `events`")[2]
    documented = set(re.findall(r"`([a-z_]+)`", about.partition("in UTC")[0]))
    assert documented == set(told) and "sentence" in documented
    assert told["sentence"] == sentence(fall) and told["start_ns"] == fall.start_ns
