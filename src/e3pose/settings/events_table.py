"""`[events]` of a site file: which events of people a site tells, and when."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds

TIME = r"([01]\d|2[0-3]):[0-5]\d"
HOURS = re.compile(f"{TIME}-{TIME}")
NAMING = ("foxglove", "homeassistant", "mqtt", "osc", "python", "webhook")


@dataclass(frozen=True, slots=True)
class EventsTable:
    """`[events]`: what people do that the site tells.

    Attributes:
        kinds: names in `events.rules.RULES`, or of one's own rules; none stand for all of `RULES`.
        fall_s: seconds on the floor after going down fast before a fall is reported.
        lies_s: seconds somebody is on the floor before it is reported, with or without a fall.
        settled_s: seconds on a bed or a seat before leaving it is reported.
        nobody_s: seconds without anybody before that is reported; 0: never.
        most_people: more people than that are reported as too many; 0: never.
        quiet: hours in which webhooks tell only what is urgent, such as `22:00-06:30`; empty: none.
        urgent: kinds that they tell in these hours too.
        names: to whom people's names in the store are told, some of `NAMING`; none: to nobody.
    """

    kinds: tuple[str, ...] = ()
    fall_s: Annotated[float, Meta(ge=0.2, le=600)] = 2.0
    lies_s: Annotated[float, Meta(ge=1, le=1e6)] = 20.0
    settled_s: Annotated[float, Meta(ge=1, le=1e6)] = 10.0
    nobody_s: Annotated[float, Meta(ge=0, le=1e7)] = 0.0
    most_people: Annotated[int, Meta(ge=0, le=1000)] = 0
    quiet: str = ""
    urgent: tuple[str, ...] = ("fall", "on-floor")
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.quiet and HOURS.fullmatch(self.quiet) is None:
            raise InputError("quiet", repr(self.quiet[:40]), 'two times, such as "22:00-06:30"')
        for one in self.names:
            if one not in NAMING:
                raise InputError("names", repr(one[:40]), f"some of {', '.join(NAMING)}")

    def is_quiet(self, hour: int, minute: int) -> bool:
        """Return whether a time of day is in the quiet hours."""
        if not self.quiet:
            return False
        begins, ends = self.quiet.split("-")
        now = f"{hour:02d}:{minute:02d}"
        return begins <= now < ends if begins <= ends else not ends <= now < begins
