"""The page of a week: who was there, where, what was told; one file, without a script."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from string import Template

from e3pose.base.atomic import write_file
from e3pose.base.quantities import plural
from e3pose.output.report.page import packaged, shown_text
from e3pose.output.report.week import EVERYBODY, NO_NAME, Notable, Week

MOST_EVENTS = 200  # of the list
KINDS = {
    "fall": "fell", "on-floor": "on the floor", "got-up": "got up", "left": "left",
    "waved": "waved", "nobody": "nobody seen", "too-many": "too many people",
}  # fmt: skip
TITLES = {"zone": "where", "state": "what they did", "event": "what was told"}
NOTES = (
    "Not a medical or safety device: falls are missed, and some that are told were none. Times are "
    "those of the machine that wrote this page. A person is the tracks that have a name "
    "(e3pose people name). How long somebody was there is exact to a minute; zones count stays "
    "that have ended; what a person did is of minutes in which nobody else was there. "
    "Minutes in which the site did not run say nothing."
)


def write_week(week: Week, path: Path) -> None:
    """Write the page of some days to a file, which is replaced if it exists."""
    write_file(path, render(week), private=True)


def render(week: Week) -> str:
    """Return the page of some days as text."""
    people = "".join(_person(week, name) for name in week.people)
    return Template(packaged("week.html")).substitute(
        title=shown_text(f"{week.site}: {_period(week)}"),
        sentences=shown_text(" ".join(sentences(week)), 2000),
        cards="".join(
            f"<div{' class=alarm' * alarm}><b>{value}</b><span>{shown_text(name)}</span></div>"
            for value, name, alarm in _cards(week)
        ),
        sections=people + _everybody(week) + _list(week.events),
        notes=shown_text(NOTES, 2000),
    )


def sentences(week: Week) -> list[str]:
    """Return the two sentences on top: who was there, and what was told."""
    there = [
        f"{f'people {name}' if name == NO_NAME else name} for {amount(seconds)}"
        for name in week.people
        if (seconds := week.total(name, "there"))
    ]
    verb = "were" if len(there) != 1 or there[0].startswith("people") else "was"
    seen = f"{_listed(there)} {verb} there; " if there else ""
    first = (
        f"{seen}nobody was seen for {amount(week.total(EVERYBODY, 'nobody'))} of "
        f"{amount(week.total(EVERYBODY, 'watched'))} that were watched."
    )
    first = first[0].upper() + first[1:]
    falls = [event for event in week.events if event.kind == "fall"]
    lies = [event for event in week.events if event.kind == "on-floor"]
    if not falls and not lies:
        return [first, "No fall and no long lie on the floor was told."]
    last = max((*falls, *lies), key=lambda event: event.start_ns)
    told = f"{plural(len(falls), 'fall')} and {plural(len(lies), 'long lie')} on the floor"
    who = "somebody" if last.who == NO_NAME else last.who
    where = f" near {last.zone}" if last.zone else ""
    verb = "were" if len(falls) + len(lies) != 1 else "was"
    second = f"{told} {verb} told, the last of {who}{where} on {_when(last.start_ns)}."
    return [first, second]


def amount(seconds: float) -> str:
    """Return a time as people say it: 45 s, 12 min, 3.5 h."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _period(week: Week) -> str:
    first, last = week.days[0], week.days[-1]
    if first == last:
        return f"{first:%A}, {first.day} {first:%B %Y}"
    return f"{first.day} {first:%B} to {last.day} {last:%B %Y}"


def _when(time_ns: int) -> str:
    moment = datetime.fromtimestamp(time_ns / 1e9)
    return f"{moment:%A} {moment.day} {moment:%B} at {moment:%H:%M}"


def _short(time_ns: int) -> str:
    moment = datetime.fromtimestamp(time_ns / 1e9)
    return f"{moment:%a} {moment.day} {moment:%b} {moment:%H:%M}"


def _listed(words: Sequence[str]) -> str:
    begin = ", ".join(words[:-1])
    return f"{begin} and {words[-1]}" if begin else words[-1]


def _cards(week: Week) -> Iterable[tuple[str, str, bool]]:
    counts = {kind: sum(event.kind == kind for event in week.events) for kind in KINDS}
    yield str(counts["fall"]), "falls told", counts["fall"] > 0
    yield str(counts["on-floor"]), "long lies on the floor", counts["on-floor"] > 0
    yield amount(week.total(EVERYBODY, "nobody")), "nobody seen", False
    yield amount(week.total(EVERYBODY, "watched")), "watched", False


def _person(week: Week, name: str) -> str:
    """Return the section of a person: a table by day."""
    title = "People without a name" if name == NO_NAME else name
    there = {"": {"there": week.figures.get((name, "there", ""), [0.0] * len(week.days))}}
    groups = {TITLES[what]: week.of(name, what) for what in TITLES}
    return _section(week, title, {**there, **groups})


def _everybody(week: Week) -> str:
    zeros = [0.0] * len(week.days)
    site = {
        name: week.figures.get((EVERYBODY, what, ""), zeros)
        for what, name in (("watched", "watched"), ("nobody", "nobody seen"))
    }
    groups = {TITLES[what]: week.of(EVERYBODY, what) for what in TITLES}
    return _section(week, "Everybody together", {"": site, **groups})


def _section(week: Week, title: str, groups: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    head = "".join(f"<th class=n>{day:%a} {day.day}</th>" for day in week.days)
    rows = list[str]()
    for group, amounts in groups.items():
        for index, (name, by_day) in enumerate(amounts.items()):
            counts = group == TITLES["event"]
            called = KINDS.get(name, name) if counts else name
            label = f"<th scope=row title='{shown_text(called)}'>{shown_text(called)}</th>"
            cells = "".join(_cell(value, counts, max(by_day)) for value in by_day)
            total = _cell(sum(by_day), counts, 0.0)
            if group and not index:
                span = len(week.days) + 2
                rows.append(f"<tr class=first><th colspan={span} class=what>{group}</th></tr>")
            rows.append(f"<tr>{label}{total}{cells}</tr>")
    return (
        f"<section><h2>{shown_text(title)}</h2><div class=wide><table><thead><tr><th></th>"
        f"<th class=n>together</th>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        "</section>"
    )


def _cell(value: float, counts: bool, most: float) -> str:
    if not value:
        return "<td class=n>–</td>"
    share = f" style='--share:{100 * value / most:.0f}%'" if most else ""
    return f"<td class=n{share}>{f'{value:.0f}' if counts else amount(value)}</td>"


def _list(events: Sequence[Notable]) -> str:
    """Return the section with the events, newest first."""
    if not events:
        return ""
    rows = "".join(
        f"<tr><td>{_short(event.start_ns)}</td><td>{shown_text(_who(event))}</td>"
        f"<td>{shown_text(KINDS.get(event.kind, event.kind))}</td><td>{shown_text(event.zone)}</td>"
        f"<td class=n>{'' if event.lasted_s is None else amount(event.lasted_s)}</td></tr>"
        for event in list(reversed(events))[:MOST_EVENTS]
    )
    more = len(events) - MOST_EVENTS
    rest = f"<p class=soft>{more} older ones are not listed.</p>" if more > 0 else ""
    return (
        "<section><h2>What was told</h2><div class=wide><table><thead><tr><th>when</th>"
        "<th>who</th><th>what</th><th>near</th><th class=n>lasted</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>{rest}</section>"
    )


def _who(event: Notable) -> str:
    return {EVERYBODY: "", NO_NAME: "somebody"}.get(event.who, event.who)
