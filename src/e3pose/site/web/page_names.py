"""What people in sight are called and drawn in, as the store has it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Engine

from e3pose.base.errors import InputError
from e3pose.store.people import Called, names_of

LOOK_S = 5.0  # between two looks at names that others may have changed


@dataclass(eq=False)
class PageNames:
    """What people in sight are called, as of the last look at the store.

    Attributes:
        place: the store; None where nothing is stored.
        site: whose people.
        now_s: a clock that only goes forward.
        run: number of the run that runs; None while the store does not have it.
        called: its tracks that have a name or a colour.
    """

    place: str | Path | None = None
    site: str = ""
    now_s: Callable[[], float] = time.monotonic
    run: int | None = None
    called: Mapping[int, Called] = field(default_factory=dict)
    _due_s: float = 0.0
    _of_ns: int = 0
    _engines: dict[str, Engine] = field(default_factory=dict)

    def due(self, run_ns: int) -> bool:
        """Return whether it is time to look, for a run that began then."""
        return self.place is not None and (run_ns != self._of_ns or self.now_s() >= self._due_s)

    def look(self, run_ns: int) -> bool:
        """Look at the store; return whether anything changed since the last look."""
        if self.place is None:
            return False
        before = self.run, self.called
        self._due_s, self._of_ns = self.now_s() + LOOK_S, run_ns
        try:
            self.run, self.called = names_of(self.place, self.site, run_ns, self._engines)
        except InputError:  # no store yet, or one that cannot be read now: nobody has a name
            self.run, self.called = None, {}
        return before != (self.run, self.called)

    def body(self) -> dict[str, Any]:
        """Return them as a status has them."""
        named = [{"track": track, **one._asdict()} for track, one in self.called.items()]
        return {"run": self.run, "names": named}
