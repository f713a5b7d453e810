"""Acknowledgements: which hubs know of the deletions at a site."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import delete, insert, select

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.forgetting import Forgotten, changing, requests

MOST_HUBS = 100  # of a site that are remembered; those that asked last


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """A deletion, and the hubs that know of it.

    Attributes:
        what: the deletion.
        informed: hubs that have fetched the outbox up to it.
        pending: hubs that have not; they are told when they ask next.
    """

    what: Forgotten
    informed: tuple[str, ...]
    pending: tuple[str, ...]


def note_taken(store: str | Path, site: str, hub: str, taken: int, now_ns: int) -> None:
    """Note the number up to which a hub has the outbox of a site.

    Raises:
        InputError: when the store cannot be written.
    """
    table = schema.hubs
    with changing(store) as engine, engine.begin() as connection:
        mine = table.c.site == site
        connection.execute(delete(table).where(mine, table.c.hub == hub))
        new = {"site": site, "hub": hub, "taken": taken, "asked_ns": now_ns}
        connection.execute(insert(table), new)
        asked = select(table.c.hub).where(mine).order_by(table.c.asked_ns.desc())
        gone = connection.execute(asked.offset(MOST_HUBS)).scalars().all()
        connection.execute(delete(table).where(mine, table.c.hub.in_(gone)))


def acknowledgements(store: str | Path, site: str) -> list[Acknowledgement]:
    """Return the deletions at a site, oldest first, and which hubs know of each.

    Raises:
        InputError: when there is no store, or one that cannot be used.
    """
    table, found = schema.hubs, list[Acknowledgement]()
    with changing(store) as engine, engine.connect() as connection:
        hubs = connection.execute(select(table).where(table.c.site == site)).all()
        for what in requests(connection, site):
            number = what.outbox_number
            informed = sorted(row.hub for row in hubs if number <= row.taken)
            pending = sorted(row.hub for row in hubs if number > row.taken)
            found.append(Acknowledgement(what, tuple(informed), tuple(pending)))
    return found


@dataclass(slots=True, eq=False)
class Hubs:
    """Notes hubs' progress when it changes; called on threads of the transport.

    Attributes:
        store: path or URL.
        site: its name.
    """

    store: str | Path
    site: str
    # Whether the next question of a hub says something new.
    _due: dict[str, bool] = field(default_factory=dict)

    def asked(self, hub: str, after: int, told: bool, now_ns: int) -> None:
        """Take a question.

        Args:
            hub: who asks.
            after: the number up to which it has the outbox.
            told: whether the answer tells of deletions, which its next question confirms.
            now_ns: the time.
        """
        if self._due.get(hub, True):
            try:
                note_taken(self.store, self.site, hub, after, now_ns)
            except InputError:  # of a full disk, say: noted with a later question
                return
        self._due[hub] = told
