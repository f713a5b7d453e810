"""The part of the API about people: who has a name, and how operators change names and colours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Request
from pydantic import Field

from e3pose.base.quantities import plural
from e3pose.site.web.api import LARGEST, REFUSALS, asked
from e3pose.site.web.control import REFUSALS as CONTROL_REFUSALS
from e3pose.site.web.control import Changes, Done
from e3pose.store.people import (
    MAX_NAME,
    StoredPerson,
    Track,
    people_of,
    set_colour,
    set_name,
)

Number = Annotated[int, Field(ge=0, le=LARGEST)]


class PersonChanges(Changes):
    """Name and colour of a person; None keeps one, an empty text removes it."""

    run: Annotated[Number, Field(description="of the store")]
    track: Number
    name: Annotated[str | None, Field(max_length=MAX_NAME)] = None
    colour: Annotated[str | None, Field(max_length=20)] = None
    only: Annotated[bool, Field(description="this track, not all of the person's")] = False


def make_people(
    place: str | Path | None,
    site: str,
    changed: Callable[[], object],
    log: Callable[[str], object],
) -> APIRouter:
    """Return the routes of named people.

    Args:
        place: the store; None where nothing is stored.
        site: whose people.
        changed: called when somebody got a name or a colour.
        log: called with a line about it, without the name.
    """
    people = APIRouter(prefix="/api")
    if place is None:
        return people

    @people.get("/people", summary="People who have a name", responses=REFUSALS)
    def named() -> list[dict[str, Any]]:
        return [_body(one) for one in asked(lambda: people_of(place, site, named=True))]

    @people.post(
        "/control/people", summary="Name a person, or choose a colour", responses=CONTROL_REFUSALS
    )
    def name(request: Request, changes: PersonChanges) -> Done:
        track = changes.run, changes.track
        said = []

        def change() -> None:
            tracks = (track,) if changes.only else _tracks_of_person(place, site, track)
            if changes.name is not None:
                count = set_name(place, tracks, changes.name.strip() or None)
                said.append(f"Named {plural(count, 'track')}" if changes.name else "Name removed")
            if changes.colour is not None:
                set_colour(place, tracks, changes.colour or None)
                said.append(f"Colour: {changes.colour}" if changes.colour else "Usual colour")

        asked(change)
        if said:
            who = getattr(request.state, "client", "")
            log(f"page: {who} changed name or colour of track {track[1]} of run {track[0]}")
            changed()
        return Done(said=". ".join(said))

    return people


def _tracks_of_person(place: str | Path, site: str, track: Track) -> tuple[Track, ...]:
    """Return all tracks of a track's person: by name, or the track alone."""
    for person in people_of(place, site, named=True):
        if track in person.tracks:
            return person.tracks
    return (track,)


def _body(person: StoredPerson) -> dict[str, Any]:
    return {
        "name": person.name,
        "colour": person.colour,
        "tracks": [{"run": run, "track": track} for run, track in person.tracks],
        "first_ns": person.first_ns,
        "last_ns": person.last_ns,
    }
