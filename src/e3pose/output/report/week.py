"""What a store knows of people over some days: who was there, where, what was told."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, time, timedelta
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.model.person_event import ONCE
from e3pose.store import Store
from e3pose.store.people import people_of
from e3pose.store.rows import NS

EVERYBODY, NO_NAME = "everybody", "without a name"
MOST_DAYS = 31
Spans = list[tuple[int, int]]  # nanoseconds since 1970, in order, apart
Who = tuple[int, int]  # run and track


@dataclass(frozen=True, slots=True)
class Notable:
    """An event of a person: `lasted_s` is None while its end is not known."""

    start_ns: int
    kind: str
    who: str
    zone: str
    score: float | None
    lasted_s: float | None


@dataclass(frozen=True, slots=True)
class Week:
    """Some days of a site.

    Attributes:
        site: its name.
        days: local days, oldest first.
        figures: amounts by day, by `(who, what, name)`; `what` is `there`, `zone`, `state`,
            `event`, `watched` or `nobody`, and all but events are seconds.
        events: oldest first.
    """

    site: str
    days: tuple[date, ...]
    figures: Mapping[tuple[str, str, str], list[float]]
    events: tuple[Notable, ...] = ()

    @property
    def people(self) -> list[str]:
        """Names, in order; those without one last."""
        names = {who for who, _, _ in self.figures} - {EVERYBODY}
        return sorted(names, key=lambda name: (name == NO_NAME, name))

    def of(self, who: str, what: str) -> dict[str, list[float]]:
        """Return amounts by day of each name, largest first."""
        found = {
            name: amounts for (w, k, name), amounts in self.figures.items() if (w, k) == (who, what)
        }
        return dict(sorted(found.items(), key=lambda item: -sum(item[1])))

    def total(self, who: str, what: str, name: str = "") -> float:
        """Return the amount of all days; 0 of what there is not."""
        return sum(self.figures.get((who, what, name), ()))

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each day, person and figure, for tables."""
        return [
            {
                "day": day.isoformat(), "who": who, "what": what, "name": name,
                "amount": round(amount, 3), "unit": "count" if what == "event" else "s",
            }
            for (who, what, name), amounts in sorted(self.figures.items())
            for day, amount in zip(self.days, amounts, strict=True)
        ]  # fmt: skip


def week_of(store: Store, place: str, site: str, last: date, count: int = 7) -> Week:
    """Return the days up to one, that included.

    Args:
        store: of the site.
        place: path or URL of it.
        site: name.
        last: local day.
        count: of days.

    Raises:
        InputError: when the store has no minute of these days.
    """
    check_within("--days", count, 1, MOST_DAYS)
    days = tuple(last - timedelta(days=count - 1 - i) for i in range(count))
    tally = Tally(days)
    start_ns, end_ns = tally.bounds_ns[0], tally.bounds_ns[-1] - 1
    minutes = store.rows("summaries", start_ns, end_ns, site=site)
    if not minutes:
        wanted = "minutes that a running edge with [store] stored"
        raise InputError(f"{days[0]} to {days[-1]}", "nothing of the site", wanted)
    who, there = _people(place, site)
    _add_minutes(tally, minutes, there)
    _add_zones(tally, store.rows("zones", start_ns, end_ns, site=site), who)
    events = _events(store.rows("events", start_ns, end_ns, site=site), who)
    for event in events:
        tally.count((event.who, "event", event.kind), event.start_ns)
    return Week(site, days, dict(tally.figures), tuple(events))


@dataclass(slots=True, eq=False)
class Tally:
    """Sums by day."""

    days: tuple[date, ...]
    bounds_ns: list[int] = field(init=False)
    figures: dict[tuple[str, str, str], list[float]] = field(init=False)

    def __post_init__(self) -> None:
        ends = (*self.days, self.days[-1] + timedelta(days=1))
        self.bounds_ns = [round(datetime.combine(d, time()).timestamp()) * NS for d in ends]
        self.figures = defaultdict(lambda: [0.0] * len(self.days))

    def spend(self, key: tuple[str, str, str], start_ns: int, end_ns: int) -> None:
        """Add the seconds of a time to its days."""
        for index, (begin, end) in enumerate(zip(self.bounds_ns, self.bounds_ns[1:], strict=False)):
            overlap = min(end, end_ns) - max(begin, start_ns)
            if overlap > 0:
                self.figures[key][index] += overlap / NS

    def count(self, key: tuple[str, str, str], time_ns: int, amount: float = 1.0) -> None:
        """Add an amount to the day of a time."""
        for index, (begin, end) in enumerate(zip(self.bounds_ns, self.bounds_ns[1:], strict=False)):
            if begin <= time_ns < end:
                self.figures[key][index] += amount


def joined(spans: Sequence[tuple[int, int]]) -> Spans:
    """Return spans of time in order, those that touch as one."""
    found: Spans = []
    for start, end in sorted(spans):
        if found and start <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end)
        elif end > start:
            found.append((start, end))
    return found


def _people(place: str, site: str) -> tuple[dict[Who, str], dict[str, Spans]]:
    """Return the name of each track, and when each person was there at the earliest and latest."""
    who, there = dict[Who, str](), defaultdict[str, Spans](list)
    for person in people_of(place, site):
        name = person.name or NO_NAME
        who |= dict.fromkeys(person.tracks, name)
        there[name] += person.spans
    return who, {name: joined(spans) for name, spans in there.items()}


def _add_minutes(
    tally: Tally, minutes: Sequence[Mapping[str, Any]], there: Mapping[str, Spans]
) -> None:
    """Add who was there, and what they did, minute by minute.

    A minute in which nobody was seen is nobody's, though a track may go on across it. The states of
    a minute belong to a person who was alone in it.
    """
    for row in minutes:
        start_ns = row["time_ns"]
        end_ns = start_ns + round(row["span_s"] * NS)
        if not row["slots"]:
            continue
        tally.spend((EVERYBODY, "watched", ""), start_ns, end_ns)
        if not row["most_people"]:
            tally.spend((EVERYBODY, "nobody", ""), start_ns, end_ns)
            continue
        present = {
            name: (max(begin, start_ns), min(end, end_ns))
            for name, spans in there.items()
            for begin, end in spans
            if begin < end_ns and end > start_ns
        }
        for name, (begin, end) in present.items():
            tally.spend((name, "there", ""), begin, end)
        alone = len(present) == 1 and row["most_people"] == 1
        for state, amount in json.loads(row["states"]).items():
            tally.count((EVERYBODY, "state", state), start_ns, 60 * amount)
            if alone:
                tally.count((next(iter(present)), "state", state), start_ns, 60 * amount)
        for zone, amount in json.loads(row["zones"]).items():
            tally.count((EVERYBODY, "zone", zone), start_ns, 60 * amount)


def _add_zones(tally: Tally, rows: Sequence[Mapping[str, Any]], who: Mapping[Who, str]) -> None:
    """Add the stays of each person in zones that have ended."""
    for row in rows:
        if row["kind"] == "leave":
            name = who.get((row["run_id"], row["track_id"]), NO_NAME)
            start_ns = row["time_ns"] - round(row["stayed_s"] * NS)
            tally.spend((name, "zone", row["zone"]), start_ns, row["time_ns"])


def _events(rows: Sequence[Mapping[str, Any]], who: Mapping[Who, str]) -> list[Notable]:
    """Return what people did, each once: with how long it lasted where its end is stored."""
    return sorted(_told(rows, who), key=lambda event: event.start_ns)


def _told(rows: Sequence[Mapping[str, Any]], who: Mapping[Who, str]) -> Iterator[Notable]:
    ended = {
        (row["kind"], row["track_id"], row["start_ns"]): row["time_ns"]
        for row in rows
        if row["phase"] == "ended"
    }
    for row in rows:
        if not (row["phase"] == "begun" or (row["phase"] and row["kind"] in ONCE)):
            continue
        track, start_ns = row["track_id"], row["start_ns"]
        name = who.get((row["run_id"], track), NO_NAME) if track >= 0 else EVERYBODY
        end_ns = ended.get((row["kind"], track, start_ns))
        lasted_s = None if end_ns is None or row["kind"] in ONCE else (end_ns - start_ns) / NS
        yield Notable(start_ns, row["kind"], name, row["zone"] or "", row["score"], lasted_s)
