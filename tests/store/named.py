"""A store of a site in which track 10 is Ada, and track 50 has no name."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import insert

from e3pose.store import schema
from e3pose.store.database import database_url, writing_engine
from e3pose.store.migrations import prepare

SITE = "lab"
ADA, NAMELESS = 10, 50


def write_named(path: Path) -> Path:
    """Write the store; return its place."""
    engine = writing_engine(database_url(path))
    with engine.begin() as connection:
        prepare(connection, str(path))
        connection.execute(insert(schema.runs), run_row(1))
        for track, name in ((ADA, "Ada"), (NAMELESS, None)):
            ends = {"first_slot": 1, "last_slot": 2, "first_ns": 1, "last_ns": 2}
            row = {"run_id": 1, "track_id": track, "name": name, **ends}
            connection.execute(insert(schema.tracks), row)
    engine.dispose()
    return path


def run_row(run_id: int) -> dict[str, object]:
    """Return a run of the site."""
    return {
        "run_id": run_id, "site": SITE, "name": "", "started_ns": run_id,
        "interval_ns": 80_000_000, "skeleton": "coco17", "joints": '["nose"]',
        "cameras": '["cam0"]', "software": "test",
    }  # fmt: skip
