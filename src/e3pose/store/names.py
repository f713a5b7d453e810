"""Names and colours of a site's people, as of the last look at its store.

Nothing of a name is kept elsewhere: who renames or forgets somebody has done so at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import Engine

from e3pose.base.errors import InputError
from e3pose.store.people import Called, names_of

KEPT_S = 0.5  # a look serves for so long: a stream asks for everybody in each slot


@dataclass(slots=True, eq=False)
class StoredNames:
    """Names and colours by track of one run; none if the store cannot be read.

    Attributes:
        place: path or URL of the store; None where nothing is stored.
        site: whose people.
        now_s: a clock that only goes forward.
        kept_s: for how long a look serves.
        run: number of the run; None while the store does not have it.
        called: its tracks that have a name or a colour.
        first_ns: when those who are there came, by track, nanoseconds since 1970.
    """

    place: str | Path | None = None
    site: str = ""
    now_s: Callable[[], float] = time.monotonic
    kept_s: float = KEPT_S
    run: int | None = None
    called: Mapping[int, Called] = field(default_factory=dict)
    first_ns: Mapping[int, int] = field(default_factory=dict)
    _due_s: float = 0.0
    _of_ns: int | None = 0
    _engines: dict[str, Engine] = field(default_factory=dict)

    def __call__(self, track: int) -> str:
        """Return the name of a track of the newest run; empty where it has none."""
        if self.due(None):
            self.look(None)
        found = self.called.get(track)
        return (found.name or "") if found else ""

    def due(self, run_ns: int | None) -> bool:
        """Return whether it is time to look, for a run that began then; None for the newest."""
        return self.place is not None and (run_ns != self._of_ns or self.now_s() >= self._due_s)

    def look(self, run_ns: int | None) -> bool:
        """Look at the store; return whether anything changed since the last look."""
        if self.place is None:
            return False
        before = self.run, self.called
        self._due_s, self._of_ns = self.now_s() + self.kept_s, run_ns
        try:
            self.run, self.called, self.first_ns = names_of(
                self.place, self.site, run_ns, self._engines
            )
        except InputError:  # no store yet, or one that cannot be read now
            self.run, self.called, self.first_ns = None, {}, {}
        return before != (self.run, self.called)
