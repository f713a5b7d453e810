"""Clips: marked stretches of a store, with a name and a note."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, delete, exists, func, insert, inspect, select, update

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import reading
from e3pose.store.forgetting import changing

MAX_NAME, MAX_NOTE = 100, 1000
MOST = 10_000  # of a site
LONGEST_NS = 8 * 86_400 * 10**9
LAST_NS = 2**62  # the year 2116


@dataclass(frozen=True, slots=True)
class Clip:
    """A stretch of a store.

    Attributes:
        name: what somebody calls it.
        start_ns: its first time, nanoseconds since 1970.
        end_ns: its last.
        note: what else there is to say; may be empty.
        number: in the store; 0 before it is kept.
        made_ns: when it was marked.
    """

    name: str
    start_ns: int
    end_ns: int
    note: str = ""
    number: int = 0
    made_ns: int = 0

    def __post_init__(self) -> None:
        good = self.name.strip() and len(self.name) <= MAX_NAME and self.name.isprintable()
        if not good:
            raise InputError("name", repr(self.name)[:40], f"1 to {MAX_NAME} characters, one line")
        if len(self.note) > MAX_NOTE or "\0" in self.note:
            raise InputError("note", f"{len(self.note)} characters", f"at most {MAX_NOTE}, no NUL")
        if not 0 <= self.start_ns < self.end_ns <= LAST_NS:
            raise InputError("end", "no time after the start", "the earlier time first")
        if self.end_ns - self.start_ns > LONGEST_NS:
            days = (self.end_ns - self.start_ns) / 86_400e9
            raise InputError("end", f"a clip of {days:.0f} days", "eight days at most")


def clips_of(store: str | Path, site: str) -> list[tuple[Clip, bool]]:
    """Return the clips of a site, newest first, and whether the store still has slots of each.

    Raises:
        InputError: when the store cannot be read.
    """
    clips, slots, runs = schema.clips.c, schema.slots.c, schema.runs.c
    with reading(store) as connection:
        if not inspect(connection).has_table("clips"):
            return []  # a store of an earlier version
        inside = slots.time_ns.between(clips.start_ns, clips.end_ns)
        mine = slots.run_id.in_(select(runs.run_id).where(runs.site == site))
        there = exists().where(inside, mine)
        asked = select(schema.clips, there.label("there")).where(clips.site == site)
        return [(_clip(row._mapping), bool(row.there)) for row in
                connection.execute(asked.order_by(clips.start_ns.desc()))]  # fmt: skip


def keep_clip(store: str | Path, site: str, clip: Clip) -> Clip:
    """Keep a clip; return it with its number.

    Raises:
        InputError: when there are too many, or the store cannot be written.
    """
    table = schema.clips
    with changing(store) as engine, engine.begin() as connection:
        mine = select(func.count()).select_from(table).where(table.c.site == site)
        if (connection.scalar(mine) or 0) >= MOST:
            raise InputError("clips", MOST, "fewer: delete some")
        values = {name: value for name, value in asdict(clip).items() if name != "number"}
        made = connection.execute(insert(table).values(site=site, **values))
        (number,) = made.inserted_primary_key or (0,)
    return Clip(**{**asdict(clip), "number": int(number)})


def change_clip(store: str | Path, site: str, number: int, changes: Mapping[str, str]) -> Clip:
    """Give a clip another name or note; return it.

    Raises:
        InputError: for a clip that the site does not have, or a name or note that is none.
    """
    table = schema.clips
    with changing(store) as engine, engine.begin() as connection:
        row = _row(connection, site, number)
        changed = _clip({**row, **changes})
        mine = table.c.number == number
        connection.execute(update(table).where(mine).values(name=changed.name, note=changed.note))
    return changed


def remove_clip(store: str | Path, site: str, number: int) -> Clip:
    """Remove a clip but not its poses; return it.

    Raises:
        InputError: for a clip that the site does not have.
    """
    with changing(store) as engine, engine.begin() as connection:
        row = _row(connection, site, number)
        connection.execute(delete(schema.clips).where(schema.clips.c.number == number))
    return _clip(row)


def _row(connection: Connection, site: str, number: int) -> Mapping[Any, Any]:
    table = schema.clips
    mine = (table.c.number == number) & (table.c.site == site)
    row = connection.execute(select(table).where(mine)).mappings().first()
    if row is None:
        raise InputError("clip", number, "one of the site")
    return row


def _clip(row: Mapping[Any, Any]) -> Clip:
    names = ("name", "start_ns", "end_ns", "note", "number", "made_ns")
    return Clip(**{name: row[name] for name in names})
