"""Stores of some hours, for archives."""

from __future__ import annotations

from pathlib import Path

from tests.store.conftest import record as make_record
from tests.store.conftest import run as make_run

from e3pose.store import Event, StoreWriter, WriterSettings
from e3pose.store.rows import NS

HOUR = 3600 * NS
DAY = 24 * HOUR
BEGIN = 1_795_046_400 * NS  # midnight, UTC
assert BEGIN % DAY == 0
FIRST_DAY, SECOND_DAY = "2026-11-19", "2026-11-20"
SLOTS_PER_HOUR = 60
PEOPLE = (10, 11)


def fill(store: Path | str, hours: range, site: str = "hall") -> None:
    """Write hours after `BEGIN`, a slot per minute with persons 10 and 11, and an event of each."""
    run = make_run(site, BEGIN)
    with StoreWriter(store, run, WriterSettings(commit_s=0.02)) as writer:
        for hour in hours:
            for minute in range(SLOTS_PER_HOUR):
                slot = hour * SLOTS_PER_HOUR + minute
                time_ns = BEGIN + slot * 60 * NS
                writer.append(make_record(slot), time_ns=time_ns, wait=True)
            assert writer.flush(60)
            for track in PEOPLE:
                began = BEGIN + hour * HOUR
                writer.event(Event(began, "fall", f"Person {track} fell", track_id=track))
        assert writer.flush(60)
        assert writer.status().problem is None
