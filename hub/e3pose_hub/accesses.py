"""The log of accesses: who opened the live page of which site, written before it is shown."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, Engine, delete, func, insert, select, true

from e3pose.base.errors import InputError
from e3pose.store.database import REFUSALS, refusal_of
from e3pose_hub.database import accesses, open_hub

MOST = 100_000  # accesses; the oldest of those who have most make room
SPARE = 1000  # beyond them, so that room is not made each time
MOST_LETTERS = 500  # of what was done


@dataclass(frozen=True, slots=True)
class Access:
    """One access to the live page of a site.

    Attributes:
        time_ns: when, nanoseconds since 1970, UTC.
        who: user of the hub.
        site: its name.
        what: such as `live page, to see`.
    """

    time_ns: int
    who: str
    site: str
    what: str


def log_accesses(engine: Engine, who: str, sites: Sequence[str], what: str) -> None:
    """Log an access to some sites.

    Raises:
        InputError: when it cannot be stored: then nothing may be shown.
    """
    time_ns, table = time.time_ns(), accesses
    rows = [
        {"time_ns": time_ns, "who": who, "site": site, "what": what[:MOST_LETTERS]}
        for site in sites
    ]
    try:
        with engine.begin() as connection:
            if rows:
                connection.execute(insert(table), rows)
                newest = connection.scalar(select(func.max(table.c.number))) or 0
                if newest % SPARE < len(rows):
                    _make_room(connection)
    except REFUSALS as error:
        raise InputError(f"access cannot be logged ({refusal_of(error)})") from None


def _make_room(connection: Connection) -> None:
    """Remove the oldest accesses of the users with the most: no user displaces those of others."""
    c = accesses.c
    found = connection.execute(select(c.who, func.count()).group_by(c.who))
    counts = {who: count for who, count in found}
    most = share_of([*counts.values()], MOST)
    for who in [who for who, count in counts.items() if count > most]:
        _keep_newest(connection, most, c.who == who)
    _keep_newest(connection, MOST, true())  # where there are more people than that


def _keep_newest(connection: Connection, count: int, which: ColumnElement[bool]) -> None:
    number = accesses.c.number
    newest = select(number).where(which).order_by(number.desc())
    kept = connection.scalar(newest.offset(count - 1).limit(1))
    if kept is not None:
        connection.execute(delete(accesses).where(which, number < kept))


def share_of(counts: Sequence[int], most: int) -> int:
    """Return the most entries per user with which all together keep `most`; at least 1."""
    left = most
    for at, count in enumerate(sorted(counts)):
        share = left // (len(counts) - at)
        if count > share:
            return max(share, 1)
        left -= count
    return most


def read_accesses(
    database: str, site: str | None = None, who: str | None = None, limit: int = 100
) -> list[Access]:
    """Return accesses, newest first.

    Args:
        database: of a hub: path or URL.
        site: its name; None for all sites.
        who: name of the user; None for all users.
        limit: the most to return.
    """
    c = accesses.c
    asked = select(c.time_ns, c.who, c.site, c.what).order_by(c.number.desc()).limit(limit)
    for column, wanted in ((c.site, site), (c.who, who)):
        asked = asked if wanted is None else asked.where(column == wanted)
    engine = open_hub(database)
    with closing(engine.connect()) as connection:
        return [Access(*row) for row in connection.execute(asked)]
