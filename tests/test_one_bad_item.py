"""One bad item never blocks the others: every queue, list and folder, with any of its items bad.

The notices of a webhook are in `tests/site/streams/test_webhook.py`, the cameras of a site in
`tests/live/test_faults.py`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.memory_transport import Hub
from tests.site.streams.test_streams import slot
from tests.store.conftest import run

from e3pose.events.rules import Snapshot
from e3pose.events.watch import advance, begin_watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import COCO17
from e3pose.output.archive.manifest import Entry, Manifest, check_archive, digest, write_manifest
from e3pose.output.archive.places import Folder
from e3pose.settings.events_table import EventsTable
from e3pose.site import stream_problems, trial_notices
from e3pose.site.connect import Connection
from e3pose.site.keep.jobs import JOB, Job, jobs_in
from e3pose.site.keep.request import ExportRequest
from e3pose.site.streams.send import Sender
from e3pose.site.zones import Zones
from e3pose.store import Event, Store, StoreWriter, WriterSettings

Bad = list[bool]
Found = tuple[int, int]  # good items that came through, bad ones that were counted or named


def days_of_an_archive(bad: Bad, folder: Path) -> Found:
    place = Folder(folder)
    for number, broken in enumerate(bad):
        manifest = Manifest("hall", f"2026-11-{number + 1:02d}")
        entry = Entry(0, "a run", 0, 1, 1, (), 4, digest(b"good"))
        write_manifest(place, manifest.with_file("00-1.parquet", entry))
        path = folder / manifest.folder / ("manifest.json" if number % 2 else "00-1.parquet")
        place.write(f"{manifest.folder}/00-1.parquet", b"good")
        if broken:
            path.unlink()
            path.symlink_to("/etc/passwd") if number % 3 else path.write_bytes(b"{")
    found = check_archive(place)
    return found.files, len(found.problems)


@dataclass(eq=False)
class Taker:
    bad: bool
    taken: list[int] = field(default_factory=list)

    def slot(self, slot: Any) -> None:
        if self.bad:
            raise RuntimeError("a stream that fails")
        self.taken.append(slot.slot)

    def zone(self, event: Any) -> None: ...

    def close(self) -> None: ...


def streams_of_a_site(bad: Bad, folder: Path) -> Found:
    said, takers = list[str](), [Taker(one) for one in bad]
    takers.append(Taker(False))  # of a stream alone the program ends, and is started again
    sender = Sender(Connection("lab", Hub().join()), takers, Zones(()), said.append)
    sender._connection = [slot(7, number=number) for number in (1, 2)]  # type: ignore[assignment]
    sender._tell_cameras = lambda: None  # type: ignore[method-assign]
    sender._run()
    assert sender.failure is None and sender.sent == 2
    return sum(taker.taken == [1, 2] for taker in takers[:-1]), len(said)


class Rule:
    def __init__(self, bad: bool) -> None:
        self.bad = bad

    def begin(self) -> int:
        return 0

    def advance(self, memory: int, now: Snapshot) -> tuple[int, list[PersonEvent]]:
        if self.bad:
            raise KeyError("a rule of one's own")
        return memory + 1, []


def rules_of_events(bad: Bad, folder: Path) -> Found:
    watch = begin_watch(EventsTable(), COCO17.joints)
    rules = {f"rule{number}": Rule(one) for number, one in enumerate(bad)}
    watch = type(watch)(watch.joints, (), rules, dict.fromkeys(rules, 0), {}, {})
    watch, _ = advance(watch, slot(7))
    assert watch.shown, "people are followed all the same"
    return sum(watch.memories.values()), len(watch.faults)


def problems_of_streams(bad: Bad, folder: Path) -> Found:
    (folder / stream_problems.FOLDER).mkdir()
    for number in range(len(bad)):
        (folder / stream_problems.FOLDER / f"{number:02d}.txt").write_text("a problem")

    def lines_of(path: Path, most: int) -> list[str]:
        if bad[int(path.stem)]:
            raise PermissionError("of another user")
        return ["a problem"]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream_problems, "lines_of", lines_of)
        return len(stream_problems.problems_of(folder / "site.toml")), sum(bad)


def answers_of_streams(bad: Bad, folder: Path) -> Found:
    for number, one in enumerate(bad):
        path = folder / f"{number:02d}.answer"
        path.mkdir() if one else path.write_text("word\nit went well\n")
    return len(trial_notices._answers(folder, "word")), sum(bad)


def jobs_of_a_page(bad: Bad, folder: Path) -> Found:
    request = ExportRequest("csv", "a file", 1, 2)
    for number, one in enumerate(bad):
        job = Job(f"{number:016x}", request, 1.0)
        path = folder / job.number / JOB
        path.parent.mkdir()
        path.write_text("[" * 5000 if one else json.dumps(asdict(job)))
    return len(list(jobs_in(folder))), sum(bad)


def rows_of_a_store(bad: Bad, folder: Path) -> Found:
    path = folder / "a.db"
    with StoreWriter(path, run(), WriterSettings(commit_s=0.02)) as writer:
        for number, one in enumerate(bad):
            writer.event(Event(2**70 if one else number, "fell", "somebody fell"))
        assert writer.flush(30.0)
        refused = writer.status().shed
    return sum(row["kind"] == "fell" for row in Store(path).rows("events")), refused


QUEUES: tuple[Callable[[Bad, Path], Found], ...] = (
    days_of_an_archive, streams_of_a_site, rules_of_events, problems_of_streams,
    answers_of_streams, jobs_of_a_page, rows_of_a_store,
)  # fmt: skip


@pytest.mark.parametrize("queue", QUEUES, ids=[queue.__name__ for queue in QUEUES])
@settings(max_examples=15)
@given(bad=st.lists(st.booleans(), min_size=1, max_size=9))
def test_bad_items_are_counted_and_the_others_come_through(
    queue: Callable[[Bad, Path], Found], bad: Bad
) -> None:
    with TemporaryDirectory() as folder:
        assert queue(bad, Path(folder)) == (bad.count(False), bad.count(True))
