"""The outbox of a site: summaries of its minutes under rising numbers, for who fetches them.

A number is given once, in the order in which summaries are stored. Whoever has all up to one asks
for what comes after it. The oldest make room for new ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, delete, func, insert, inspect, select, update

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import database_url, reading, shown
from e3pose.store.forgetting import Forgotten, requests
from e3pose.store.rows import NS, Row, Run

LOST_NS = 120 * NS  # of a run without any summary, so much is summed up afterwards at most
MOST_AT_ONCE = 1000  # summaries of one answer
MOST_FORGOTTEN = 100  # deletions of one answer
# What sums need of the tables that grow; the joints themselves are not read.
NEEDED = {
    "slots": ("time_ns", "slot", "arrived", "took_s", "blind"),
    "poses": ("time_ns", "slot", "sigma_m"),
    "energy": ("time_ns", "camera_id", "energy_j", "charge", "source"),
    "events": ("time_ns", "kind", "camera_id", "phase"),
    "zones": ("time_ns", "zone", "kind", "count"),
}


@dataclass(frozen=True, slots=True)
class Outbox:
    """The content of a site's outbox.

    Attributes:
        begun_ns: when it was begun: numbers of another outbox of the site say nothing about it.
        newest: the number given last; 0 before the first.
        shed: summaries up to this number had to make room, or were deleted.
        summaries: those asked for, columns by name, JSON read.
        forgotten: what was deleted meanwhile, by its `outbox_number`.
    """

    begun_ns: int
    newest: int
    shed: int
    summaries: tuple[dict[str, Any], ...]
    forgotten: tuple[Forgotten, ...] = ()


def read_outbox(store: str | Path, site: str, after: int = 0, limit: int = MOST_AT_ONCE) -> Outbox:
    """Return the summaries of a site that come after a number, oldest first.

    Args:
        store: path or URL.
        site: whose.
        after: the number up to which they are not asked for.
        limit: the most to return.

    Raises:
        InputError: when there is no store, or one that cannot be read.
    """
    with reading(store) as connection:
        if not inspect(connection).has_table("outboxes"):
            return Outbox(0, 0, 0, ())  # of an earlier version
        found = connection.execute(
            select(schema.outboxes).where(schema.outboxes.c.site == site)
        ).first()
        if found is None:
            return Outbox(0, 0, 0, ())
        table, runs = schema.summaries, schema.runs
        rows = connection.execute(
            select(table, runs.c.started_ns)
            .join(runs, runs.c.run_id == table.c.run_id)
            .where(runs.c.site == site, table.c.number > after)
            .order_by(table.c.number)
            .limit(min(limit, MOST_AT_ONCE))
        ).mappings()
        where = shown(database_url(store))
        summaries = tuple(plain_summary(dict(row), where) for row in rows)
        told = _told(connection, site, after)
        if len(summaries) == min(limit, MOST_AT_ONCE):  # what is after them comes with the next
            told = [one for one in told if one.outbox_number < summaries[-1]["number"]]
        if len(told) > MOST_FORGOTTEN:
            told = told[:MOST_FORGOTTEN]
            summaries = tuple(r for r in summaries if r["number"] < told[-1].outbox_number)
        return Outbox(found.begun_ns, found.newest, found.shed, summaries, tuple(told))


def _told(connection: Connection, site: str, after: int) -> list[Forgotten]:
    """Return the deletions after a number, by number."""
    columns = inspect(connection).get_columns("forgotten")
    if all(column["name"] != "outbox_number" for column in columns):  # of an earlier version
        return []
    found = [one for one in requests(connection, site) if one.outbox_number > after]
    return sorted(found, key=lambda one: one.outbox_number)


def plain_summary(found: dict[str, Any], where: str) -> dict[str, Any]:
    """Decode the JSON columns of a summary; raise `InputError` if they are invalid."""
    for name in schema.SUMMARY_JSON:
        try:
            found[name] = json.loads(found[name])
        except (ValueError, TypeError, RecursionError):
            found[name] = None
        if not isinstance(found[name], list if name == "faults" else dict):
            raise InputError(f"{where}: summaries: number {found['number']}: {name} is no JSON")
    return found


def put(connection: Connection, run: Run, rows: Sequence[Mapping[str, Any]], keep: int) -> None:
    """Store summaries under the next numbers of their site; existing ones stay.

    Args:
        connection: in a transaction.
        run: whose summaries.
        rows: with their run ids.
        keep: how many of the newest stay; 0 for all.
    """
    if not rows:
        return
    boxes, table = schema.outboxes, schema.summaries
    mine = boxes.c.site == run.site
    box = connection.execute(select(boxes.c.newest).where(mine).with_for_update()).first()
    if box is None:
        new = {"site": run.site, "begun_ns": rows[0]["time_ns"], "newest": 0, "shed": 0}
        connection.execute(insert(boxes), new)
    same = table.c.run_id == rows[0]["run_id"], table.c.time_ns.in_([r["time_ns"] for r in rows])
    there = set(connection.execute(select(table.c.time_ns).where(*same)).scalars())
    newest = 0 if box is None else box.newest
    for row in rows:
        if row["time_ns"] not in there:
            newest += 1
            connection.execute(insert(table), {**row, "number": newest})
            there.add(row["time_ns"])
    connection.execute(update(boxes).where(mine).values(newest=newest))
    if keep and newest > keep:
        _shed(connection, run.site, newest - keep)


def _shed(connection: Connection, site: str, until: int) -> None:
    """Remove the summaries of a site up to a number."""
    boxes, table, runs = schema.outboxes, schema.summaries, schema.runs
    ids = select(runs.c.run_id).where(runs.c.site == site)
    connection.execute(delete(table).where(table.c.number <= until, table.c.run_id.in_(ids)))
    connection.execute(update(boxes).where(boxes.c.site == site).values(shed=until))


def unsummed(connection: Connection, run: Run, now_ns: int) -> list[Row]:
    """Return the rows of a run that no summary has, with the columns that sums need."""
    table, run_id = schema.summaries, schema.run_id_of(connection, run.site, run.started_ns)
    if run_id is None:
        return []
    newest_ns = select(func.max(table.c.time_ns)).where(table.c.run_id == run_id)
    last = connection.execute(
        select(table.c.time_ns, table.c.span_s).where(
            table.c.run_id == run_id, table.c.time_ns == newest_ns.scalar_subquery()
        )
    ).first()
    since_ns = now_ns - LOST_NS if last is None else last.time_ns + round(last.span_s * NS)
    slots = schema.slots
    # The sum hides the key's first column, as in `query`: by time, not through the run.
    first = connection.execute(
        select(func.min(slots.c.slot)).where(
            slots.c.time_ns.between(since_ns, now_ns), slots.c.run_id + 0 == run_id
        )
    ).scalar()
    if first is None:
        return []
    found: list[Row] = []
    for name, columns in NEEDED.items():
        c = schema.ROWS[name].c
        asked = select(*(c[column] for column in columns)).where(
            c.run_id == run_id, c.time_ns.between(since_ns, now_ns)
        )
        if "slot" in columns:
            asked = asked.where(c.slot >= first)
        rows = connection.execute(asked.order_by(c.time_ns)).mappings()
        found += [(name, dict(row)) for row in rows]
    return found
