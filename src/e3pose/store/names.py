"""Names of people who are there now: of the newest run, as the store has them at this moment.

Nothing of a name is kept elsewhere: who renames or forgets somebody has done so at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Engine, func, select

from e3pose.base.errors import InputError
from e3pose.store import schema
from e3pose.store.database import reading

KEPT_S = 0.5  # an answer serves for so long: a stream asks for everybody in each slot
MOST_KNOWN = 100


class StoredNames:
    """Names by track; call it for one. What cannot be read names nobody."""

    def __init__(
        self, store: str | Path, site: str, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Name the people of a site.

        Args:
            store: path or URL.
            site: name.
            now_s: a clock that only goes forward.
        """
        self._store, self._site, self._now_s = store, site, now_s
        self._engines: dict[str, Engine] = {}
        self._known: dict[int, tuple[float, str]] = {}  # by track: until when it serves, and name

    def __call__(self, track: int) -> str:
        """Return the name of a track of the newest run; empty where it has none."""
        due_s, name = self._known.get(track, (-float("inf"), ""))
        if self._now_s() >= due_s:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            try:
                name = self._read(track)
            except InputError:  # not begun, being written anew, or gone
                name = ""
            self._known[track] = self._now_s() + KEPT_S, name
        return name

    def _read(self, track: int) -> str:
        runs, tracks = schema.runs.c, schema.tracks.c
        newest = select(func.max(runs.run_id)).where(runs.site == self._site).scalar_subquery()
        asked = select(tracks.name).where(tracks.run_id == newest, tracks.track_id == track)
        with reading(self._store, self._engines) as connection:
            return connection.scalar(asked) or ""
