"""Answer hubs that fetch a site's summaries, a few at a time."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.store.acknowledgements import Hubs
from e3pose.store.outbox import Outbox, read_outbox
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import OutboxPart, OutboxQuestion, Tombstone

PER_S = 5.0  # parts of a hub: each takes milliseconds of the edge's interpreter
MOST_AT_ONCE = 4  # hubs that are answered in that time
MOST_ROWS = 100
MOST_BYTES = 500_000  # of a part; more names than usual make it fewer rows


class OutboxAnswers:
    """Answers questions for the outbox of a site; on a thread of the transport."""

    def __init__(
        self,
        store: str | Path,
        site: str,
        now_s: Callable[[], float] = time.monotonic,
        tokens: Mapping[str, Path] | None = None,
    ) -> None:
        """Name the store.

        Args:
            store: path or URL.
            site: its name.
            now_s: a clock.
            tokens: by hub, where the page finds whom of its users to let in.
        """
        self._tokens = tokens or {}
        self._store, self._site, self._now_s = store, site, now_s
        self._hubs, self._lock = Hubs(store, site), threading.Lock()
        self._free_s: dict[str, float] = {}  # when each may ask again; their names are granted

    def answer(self, topic: str, payload: bytes) -> bytes | None:
        """Return a part of the outbox; None, as if lost, to who asks too often."""
        hub = topic.rpartition("/")[2]
        with self._lock:
            now_s = self._now_s()
            self._free_s = {name: s for name, s in self._free_s.items() if s > now_s}
            if hub in self._free_s or len(self._free_s) >= MOST_AT_ONCE:
                return None
            self._free_s[hub] = now_s + 1 / PER_S
        try:
            asked = decode(payload, OutboxQuestion, "hub")
            if (path := self._tokens.get(hub)) is not None:
                with suppress(OSError):  # a full disk: those of before count until they are old
                    make_folder(path.parent)
                    write_file(path, json.dumps([asked.readers, asked.writers]), private=True)
            found = read_outbox(self._store, self._site, asked.after, MOST_ROWS)
        except InputError:  # its text has places that are none of a hub's business
            return encode(OutboxPart(problem="the summaries of the site cannot be read"))
        part = part_of(found)
        if asked.after <= found.newest:  # else it is a number of another outbox
            self._hubs.asked(hub, asked.after, bool(part.forgotten), time.time_ns())
        return encode(part)


def part_of(found: Outbox) -> OutboxPart:
    """Return summaries as a message, as many as fit."""
    rows, size = list[bytes](), 0
    for row in found.summaries:
        rows.append(msgspec.json.encode({str(name): value for name, value in row.items()}))
        size += len(rows[-1])
        if size > MOST_BYTES:
            break
    last = found.summaries[len(rows) - 1]["number"] if rows else found.newest
    whole = len(rows) == len(found.summaries)
    told = [
        Tombstone(one.outbox_number, one.start_ns, one.end_ns, one.run_started_ns, one.track_id)
        for one in found.forgotten
        if whole or one.outbox_number < last
    ]
    content = b"[" + b",".join(rows) + b"]"
    return OutboxPart(found.begun_ns, found.newest, found.shed, content, "", tuple(told))
