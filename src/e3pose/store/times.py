"""Parse points in time: relative, ISO 8601, seconds of a run."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone, tzinfo
from typing import Literal

from e3pose.base.errors import InputError
from e3pose.base.quantities import DURATIONS_S
from e3pose.store.rows import NS

UNITS_S = {**DURATIONS_S, "": 1.0, "sec": 1.0, "m": 60.0}
QUANTITY = re.compile(r"([+-]?)(\d+(?:\.\d+)?)\s*([a-z]*)")
CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d{1,6})?)?")
FORM = "2026-11-21T14:00, 14:00, 2026-11-21T13:00Z, -10min, now, or seconds of a run such as 12.5"
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
YEARS = (1970, 2200)  # int64 nanoseconds end in 2262


@dataclass(frozen=True, slots=True)
class When:
    """A point in time.

    Attributes:
        ns: nanoseconds after `origin`.
        origin: since 1970 UTC, or since a run began.
    """

    ns: int
    origin: Literal["1970", "run"]

    def absolute(self, started_ns: int) -> int:
        """Return nanoseconds since 1970, given when the run began."""
        return self.ns + (started_ns if self.origin == "run" else 0)


def parse_when(words: str, now: datetime, zone: tzinfo | None = None) -> When:
    """Read a point in time.

    Args:
        words: ISO 8601, local unless it says otherwise (`2026-11-21T14:00`, `...Z`, `...+01:00`,
            `2026-11-21`); a time of today (`14:00`); before now (`-10min`, `-2h`), `now`; seconds
            after the run began (`12.5`, `90s`, `5min`).
        now: the present, with its time zone.
        zone: what "local" means; None is this machine's, with its summer time.

    Raises:
        InputError: showing what was found and what can be written.
    """
    text = words.strip()
    if text.lower() == "now":
        return When(_ns(now), "1970")
    quantity = QUANTITY.fullmatch(text.lower())
    if quantity is not None and quantity[3] in UNITS_S:
        ns = round(float(quantity[2]) * UNITS_S[quantity[3]] * NS)
        if ns > 2**62:
            raise _error(words)
        return When(_ns(now) - ns, "1970") if quantity[1] == "-" else When(ns, "run")
    try:
        if CLOCK.fullmatch(text):
            padded = text if text[1:2] != ":" else f"0{text}"
            moment = datetime.fromisoformat(f"{now.astimezone(zone).date()}T{_micro(padded)}")
        else:
            # Python 3.10 reads neither Z nor fractions of other than 3 or 6 digits.
            moment = datetime.fromisoformat(_micro(re.sub(r"[zZ]$", "+00:00", text)))
    except ValueError:
        raise _error(words) from None
    if not YEARS[0] <= moment.year <= YEARS[1]:
        raise _error(words)
    if moment.tzinfo is None:
        moment = _at_home(moment, zone)
    return When(_ns(moment), "1970")


def as_when(value: str | datetime | int, now: datetime) -> When:
    """Return a point in time given as text, as a `datetime`, or as nanoseconds since 1970."""
    if isinstance(value, str):
        return parse_when(value, now)
    if isinstance(value, datetime):
        return When(_ns(value if value.tzinfo else _at_home(value, None)), "1970")
    return When(int(value), "1970")


def iso_text(time_ns: int) -> str:
    """Return nanoseconds since 1970 as ISO 8601, UTC, with microseconds."""
    moment = EPOCH + timedelta(microseconds=time_ns // 1000)
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")


def _at_home(moment: datetime, zone: tzinfo | None) -> datetime:
    return moment.astimezone() if zone is None else moment.replace(tzinfo=zone)


def _micro(text: str) -> str:
    return re.sub(r"\.(\d{1,6})(?=$|[+-])", lambda match: "." + match[1].ljust(6, "0"), text)


def _ns(moment: datetime) -> int:
    span = moment.astimezone(timezone.utc) - EPOCH
    return (span.days * 86400 + span.seconds) * NS + span.microseconds * 1000


def _error(words: str) -> InputError:
    return InputError("time", repr(words[:60]), FORM)
