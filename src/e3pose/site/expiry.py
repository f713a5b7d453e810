"""Report certificates of a site that expire soon, once a day, as events."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.wire.keys.renewal import expiring, renewal_advice

LOOK_S = 60.0
AGAIN = datetime.timedelta(days=1)


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)


@dataclass(slots=True, eq=False)
class ExpiryWatch:
    """Looks at the certificates in a folder now and then.

    Attributes:
        folder: of the site's keys; None where it has none.
        report: called with kind and message of an event.
        now: the system's time, UTC, by which certificates are judged.
        now_s: a steady clock.
    """

    folder: Path | None
    report: Callable[[str, str], object]
    now: Callable[[], datetime.datetime] = _now
    now_s: Callable[[], float] = time.monotonic
    _due_s: float = 0.0
    _reported: dict[tuple[str, bool], datetime.datetime] | None = None

    def update(self) -> None:
        """Report expiring certificates; cheap enough for every call of a loop."""
        if self.folder is None or self.now_s() < self._due_s:
            return
        self._due_s = self.now_s() + LOOK_S
        now, known = self.now(), self._reported or {}
        self._reported = {}
        try:
            found = list(expiring(self.folder, now))
        except InputError:  # being replaced, or said by who reads it
            self._reported = known
            return
        for name, until in found:
            key = name, until < now
            said = known.get(key)
            # A clock that was set back must not silence it.
            if said is None or not datetime.timedelta() <= now - said < AGAIN:
                self.report("certificate", _line(name, until, now))
                said = now
            self._reported[key] = said


def _line(name: str, until: datetime.datetime, now: datetime.datetime) -> str:
    advice = renewal_advice(name)
    if until < now:
        return (
            f"certificate of {name} expired on {until:%Y-%m-%d %H:%M} UTC: no new connection "
            f"is accepted with it; {advice}"
        )
    days = (until - now).days
    return f"certificate of {name} expires on {until:%Y-%m-%d}, in {days} days: {advice}"
