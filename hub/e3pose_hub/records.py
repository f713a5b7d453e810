"""Summaries as a site sends them, checked: a site is not trusted."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from e3pose.base.bounded import UNDECODABLE
from e3pose.base.errors import InputError, reason_of
from e3pose.wire.bounds import Count, Figure, TimeNs
from e3pose.wire.site_messages import OutboxPart, Tombstone

Name = Annotated[str, Meta(max_length=500)]
Figures = Annotated[dict[Name, Figure], Meta(max_length=200)]
Counts = Annotated[dict[Name, Count], Meta(max_length=200)]
RECORD = 1  # the version of the record that a hub can read


class Summary(msgspec.Struct, frozen=True):
    """A minute of a site: the columns are those of `docs/reference/outbox.md`."""

    number: Annotated[int, Meta(ge=1, le=2**62)]
    started_ns: TimeNs
    time_ns: TimeNs
    version: Annotated[int, Meta(ge=RECORD, le=RECORD)]
    span_s: Annotated[float, Meta(ge=0, le=60)]
    software: Name
    slots: Count
    views: Figure | None
    people: Figure | None
    most_people: Count
    error_mm: Figure | None
    took_ms: Figure | None
    blind: Counts
    zones: Figures
    entered: Counts
    states: Figures
    events: Counts
    joules: Annotated[dict[Name, Figures], Meta(max_length=200)]
    charge: Figures
    faults: Annotated[list[Name], Meta(max_length=200)]


MOST_ROWS, MOST_TOLD = 100, 1000  # summaries and deletions in a part, as an edge sends them
_decoder = msgspec.json.Decoder(list[Summary])


def summaries_in(part: OutboxPart, after: int, where: str) -> list[Summary]:
    """Return the summaries of an answer; raise `InputError` for an answer that no edge sends."""
    try:
        found = _decoder.decode(part.rows)
    except UNDECODABLE as error:
        raise InputError(f"{where}: summaries: {reason_of(error)[:200]}") from None
    if len(found) > MOST_ROWS:
        raise InputError(f"{where}: summaries: found {len(found)}, expected {MOST_ROWS} at most")
    before = after
    for one in found:
        if not before < one.number <= part.newest:
            raise InputError(f"{where}: summaries: found number {one.number} after {before}")
        before = one.number
    return found


def tombstones_in(part: OutboxPart, after: int, where: str) -> tuple[Tombstone, ...]:
    """Return the deletions of an answer; raise `InputError` for an answer that no edge sends."""
    before = after
    for one in part.forgotten:
        if not before < one.number <= part.newest or not one.start_ns <= one.end_ns:
            raise InputError(f"{where}: deleted: found number {one.number} after {before}")
        before = one.number
    if len(part.forgotten) > MOST_TOLD:
        raise InputError(f"{where}: deleted: found {len(part.forgotten)}, expected {MOST_TOLD}")
    return part.forgotten
