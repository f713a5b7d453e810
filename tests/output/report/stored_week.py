"""A store with a week of two people, for tests of its page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import insert

from e3pose.store import schema
from e3pose.store.database import database_url, writing_engine
from e3pose.store.migrations import prepare

LAST = date(2026, 11, 26)
SITE = "lab"
NAMELESS = 3
MINUTE_NS = 60 * 10**9


def at_ns(day: date, hour: int, minute: int = 0) -> int:
    """Return a local time."""
    return round(datetime.combine(day, time(hour, minute)).timestamp()) * 10**9


def minute_row(
    time_ns: int, number: int, most: int, states: Mapping[str, float], zones: Mapping[str, float]
) -> dict[str, Any]:
    """Return a summary of a minute."""
    empty = {name: "{}" for name in schema.SUMMARY_MAPS}
    return {
        "run_id": 1, "time_ns": time_ns, "number": number, "version": 1, "span_s": 60.0,
        "software": "test", "slots": 750, "views": 2.0, "people": float(most), "most_people": most,
        "error_mm": 20.0, "took_ms": 1.0, **empty, "faults": "[]",
        "states": json.dumps(states), "zones": json.dumps(zones),
    }  # fmt: skip


def event_row(number: int, time_ns: int, kind: str, track: int, **more: Any) -> dict[str, Any]:
    """Return an event of a person."""
    return {
        "run_id": 1, "time_ns": time_ns, "number": number, "kind": kind, "camera_id": None,
        "message": "", "track_id": track, "zone": "bed", "phase": "begun", "start_ns": time_ns,
        "score": 0.9, **more,
    }  # fmt: skip


def write_week(path: Path, name: str = "Ada") -> Path:
    """Write seven days: from 8:00 Ada for two hours, alone but for ten minutes with somebody.

    She is in bed for half an hour from 8:00; on the last day she falls at 8:40 and lies for 90 s.
    The site watches from 7:00 to 11:00.
    """
    days = [LAST - timedelta(days=i) for i in reversed(range(7))]
    minutes, tracks, zones = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
    for index, day in enumerate(days):
        start_ns = at_ns(day, 7)
        for minute in range(240):
            alone, both = 60 <= minute < 180, 170 <= minute < 180
            in_bed = 60 <= minute < 90
            states = {"lying" if in_bed else "walking": 1.0 + both} if alone else {}
            minutes.append(
                minute_row(
                    start_ns + minute * MINUTE_NS, 240 * index + minute + 1, int(alone) + both,
                    states, {"bed": 1.0} if in_bed else {},
                )
            )  # fmt: skip
        tracks.append(track_row(10 + index, at_ns(day, 8), at_ns(day, 10), name))
        tracks.append(track_row(50 + index, at_ns(day, 9, 50), at_ns(day, 10), None))
        stay = {"run_id": 1, "zone": "bed", "track_id": 10 + index, "slot": 1, "count": 0}
        enter = {**stay, "time_ns": at_ns(day, 8), "kind": "enter", "stayed_s": 0.0}
        leave = {**stay, "time_ns": at_ns(day, 8, 30), "kind": "leave", "stayed_s": 1800.0}
        zones += [enter, leave]
    fell_ns, ada = at_ns(LAST, 8, 40), 16
    told = [
        event_row(1, fell_ns + 2 * 10**9, "fall", ada, start_ns=fell_ns),
        event_row(2, fell_ns + 20 * 10**9, "on-floor", ada, start_ns=fell_ns),
        event_row(3, fell_ns + 90 * 10**9, "on-floor", ada, start_ns=fell_ns, phase="ended"),
        event_row(4, fell_ns + 91 * 10**9, "got-up", ada, phase="ended"),
        event_row(5, fell_ns, "camera-lost", ada, track_id=None, phase=None, start_ns=None),
    ]
    engine = writing_engine(database_url(path))
    with engine.begin() as connection:
        prepare(connection, str(path))
    with engine.begin() as connection:
        run = {
            "run_id": 1, "site": SITE, "name": "", "started_ns": at_ns(days[0], 7),
            "interval_ns": 80_000_000, "skeleton": "coco17", "joints": '["nose"]',
            "cameras": '["cam0"]', "software": "test",
        }  # fmt: skip
        connection.execute(insert(schema.runs), run)
        for table, rows in (
            (schema.summaries, minutes), (schema.tracks, tracks), (schema.zones, zones),
            (schema.events, told),
        ):  # fmt: skip
            connection.execute(insert(table), rows)
    engine.dispose()
    return path


def track_row(track: int, first_ns: int, last_ns: int, name: str | None) -> dict[str, Any]:
    """Return when a track was there."""
    return {
        "run_id": 1, "track_id": track, "first_slot": track, "last_slot": track + 1,
        "first_ns": first_ns, "last_ns": last_ns, "name": name,
    }  # fmt: skip


def site_file(folder: Path) -> Path:
    """Write a site file whose store is `poses.db` beside it."""
    lines = ['format = "e3pose-site"', "version = 1", f'name = "{SITE}"', "fps = 12.5",
             'calibration = "rig.toml"', "[link]", 'endpoint = "tcp/127.0.0.1:1"',
             "[store]", 'path = "poses.db"']  # fmt: skip
    (folder / "site.toml").write_text("\n".join(lines) + "\n")
    return folder / "site.toml"
