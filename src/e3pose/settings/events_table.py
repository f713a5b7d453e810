"""`[events]` of a site file: which events of people a site tells, and when."""

from __future__ import annotations

from dataclasses import dataclass

from e3pose.base.table import entry
from e3pose.settings.limits import check_within


@dataclass(frozen=True, slots=True)
class EventsTable:
    """`[events]`: what people do that the site tells.

    Attributes:
        kinds: which events; all by default.
        fall_s: somebody who went down fast has fallen after lying so long without getting up.
        lies_s: somebody who lies or sits on the floor for so long is told, however they got there.
        settled_s: so long on a bed or a seat before `left` is told.
        nobody_s: nobody was seen for so long; 0: never told.
        most_people: more people than that are too many; 0: never told.
    """

    kinds: tuple[str, ...] = entry(
        default=("fall", "on-floor", "got-up", "left", "nobody", "too-many", "waved"),
        write='["fall", "on-floor"]',
    )
    fall_s: float = 2.0
    lies_s: float = 20.0
    settled_s: float = 10.0
    nobody_s: float = 0.0
    most_people: int = 0

    def __post_init__(self) -> None:
        check_within("fall_s", self.fall_s, 0.2, 600)
        check_within("lies_s", self.lies_s, 1, 1e6)
        check_within("settled_s", self.settled_s, 1, 1e6)
        check_within("nobody_s", self.nobody_s, 0, 1e7)
        check_within("most_people", self.most_people, 0, 1000)
