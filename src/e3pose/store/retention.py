"""Retention of a store by age and size, oldest slots first, a few at a time."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, delete, func, select, text

from e3pose.store import schema
from e3pose.store.rows import NS

BATCH_SLOTS = 200  # a few milliseconds of work: eight times what 25 slots per second add
VACUUM_PAGES = 500
SIZE_OF_SERVER = (
    "max_size: found with a database server, which keeps the space of what is deleted, "
    "expected keep, such as keep = '30d'"
)


@dataclass(frozen=True, slots=True)
class Retention:
    """Limits of age and size.

    Attributes:
        max_age_s: slots older than this go.
        max_bytes: the oldest slots go while an SQLite database holds more than this.
    """

    max_age_s: float | None = None
    max_bytes: int | None = None


def trim(connection: Connection, retention: Retention, now_ns: int) -> int:
    """Remove a small batch beyond the retention; return the number of slots removed.

    Called again and again by the writer, so that no single call is long. Never the newest slot.
    """
    newest_ns = connection.execute(select(func.max(schema.slots.c.time_ns))).scalar()
    if newest_ns is None:
        return 0
    removed = 0
    if retention.max_age_s is not None:
        removed = _remove(connection, min(newest_ns, now_ns - round(retention.max_age_s * NS)))
    if not removed and retention.max_bytes is not None and _used(connection) > retention.max_bytes:
        removed = _remove(connection, newest_ns)
    return removed


def give_back(connection: Connection) -> None:
    """Return some unused pages to the file system, once there are many."""
    if connection.dialect.name != "sqlite":
        return
    free = connection.execute(text("PRAGMA freelist_count")).scalar_one()
    # What retention frees the next slots need again: only more than that is worth returning.
    if free > 8 * VACUUM_PAGES:
        # As a script: a statement ends after one page, as it returns no rows to ask for.
        connection.connection.executescript(f"PRAGMA incremental_vacuum({VACUUM_PAGES})")


def _remove(connection: Connection, before_ns: int) -> int:
    """Remove the oldest slots before a time, and earlier events of their runs."""
    slots = schema.slots
    old = select(slots.c.run_id, slots.c.slot, slots.c.time_ns).where(slots.c.time_ns < before_ns)
    keys = connection.execute(old.order_by(slots.c.time_ns).limit(BATCH_SLOTS)).all()
    for run_id in {key.run_id for key in keys}:
        mine = [key.slot for key in keys if key.run_id == run_id]
        for table in (schema.poses, slots):
            connection.execute(
                delete(table).where(
                    table.c.run_id == run_id,
                    table.c.slot.between(min(mine), max(mine)),
                    table.c.time_ns <= keys[-1].time_ns,
                )
            )
        for table in (schema.energy, schema.events, schema.zones):
            connection.execute(
                delete(table).where(table.c.run_id == run_id, table.c.time_ns <= keys[-1].time_ns)
            )
        forget_empty(connection, run_id)
    return len(keys)


def forget_empty(connection: Connection, run_id: int) -> None:
    """Remove tracks without slots, and the run if it is empty and a later one exists."""
    runs, slots, tracks = schema.runs, schema.slots, schema.tracks
    first = connection.execute(select(func.min(slots.c.slot)).where(slots.c.run_id == run_id))
    left = first.scalar()
    gone = delete(tracks).where(tracks.c.run_id == run_id)
    if left is not None:
        connection.execute(gone.where(tracks.c.last_slot < left))
        return
    site = select(runs.c.site).where(runs.c.run_id == run_id).scalar_subquery()
    newest = connection.execute(select(func.max(runs.c.run_id)).where(runs.c.site == site)).scalar()
    if newest != run_id:  # otherwise it may go on
        connection.execute(gone)
        told = schema.summaries.c.run_id
        if connection.execute(select(told).where(told == run_id).limit(1)).first() is not None:
            return  # its summaries outlive it
        connection.execute(delete(runs).where(runs.c.run_id == run_id))


def _used(connection: Connection) -> int:
    pages, free, size = (
        connection.execute(text(f"PRAGMA {name}")).scalar_one()
        for name in ("page_count", "freelist_count", "page_size")
    )
    return int((pages - free) * size)
