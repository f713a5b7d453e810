"""Changes by operators: requests to the edge, which decides, and names and colours of people."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Request
from pydantic import BaseModel, ConfigDict, Field

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.model.camera_fields import check_camera_id
from e3pose.site.joining import Joining
from e3pose.site.web.api import LARGEST, asked
from e3pose.site.web.api import REFUSALS as READ_REFUSALS
from e3pose.site.web.schemas import Refused, Shape
from e3pose.store.people import (
    MAX_NAME,
    StoredPerson,
    people_of,
    set_colour,
    set_name,
)
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Control, Controlled

Ask = Callable[[bytes], bytes | None]
Number = Annotated[int, Field(ge=0, le=LARGEST)]
REFUSALS: dict[int | str, dict[str, Any]] = {
    401: {"model": Refused, "description": "the token for writing is needed"},
    403: {"model": Refused, "description": "the token is for reading only"},
    409: {"model": Refused, "description": "the edge refuses, with the reason"},
    422: {"model": Refused, "description": "what is asked for cannot be read"},
    429: {"model": Refused, "description": "too many requests"},
    504: {"model": Refused, "description": "the edge does not answer"},
}


class Changes(BaseModel):
    """Requested settings; omitted ones stay unchanged."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class LoopChanges(Changes):
    """Changes to the selection of cameras; `cameras` and `target_error_mm` replace each other."""

    cameras: Annotated[float | None, Field(gt=0, le=1000, description="per slot")] = None
    target_error_mm: Annotated[float | None, Field(ge=1, le=1000)] = None
    quality_weight: Annotated[float | None, Field(ge=0, le=1e6, description="V")] = None


class CameraChanges(Changes):
    """Requested changes of one camera."""

    paused: bool | None = None
    budget: Annotated[
        str, Field(max_length=60, description="such as `60%`, `4W`, `until 18:00`, `for 8h`")
    ] = ""


class Done(Shape):
    """The result of a change, in words."""

    said: str


def make_control(ask: Ask) -> APIRouter:
    """Return the routes that control a site.

    Args:
        ask: sends a `Control` to the edge and returns its answer; None without one.
    """
    control = APIRouter(prefix="/api/control", responses=REFUSALS)

    @control.post("/loop", summary="Change how cameras are selected")
    def loop(changes: LoopChanges) -> Done:
        return _send(ask, Control(**changes.model_dump()))

    @control.post("/cameras/{camera_id}", summary="Pause a camera, or set its budget")
    def camera(camera_id: str, changes: CameraChanges) -> Done:
        try:
            check_camera_id(camera_id)
        except InputError as error:
            raise HTTPException(422, str(error)) from None
        return _send(ask, Control(camera_id=camera_id, **changes.model_dump()))

    return control


def make_tests(test: Callable[[], list[str]], log: Callable[[str], object]) -> APIRouter:
    """Return the route that tests notices.

    Args:
        test: has a test notice sent, and returns how that went, a line for each webhook.
        log: called with a line about what operators did.
    """
    tests = APIRouter(prefix="/api/control", responses=REFUSALS)
    running = threading.Lock()

    @tests.post("/test-notice", summary="Send a test notice to the webhooks of this machine")
    def test_notice() -> Done:
        if not running.acquire(blocking=False):
            raise HTTPException(409, "a test goes on: wait for its answer")
        try:
            said = "; ".join(test())
        except InputError as error:
            raise HTTPException(409, str(error)) from None
        finally:
            running.release()
        log(f"test notice: {said}")
        return Done(said=said)

    return tests


def make_join(joining: Joining) -> APIRouter:
    """Return the routes by which a camera joins; the code is for who may control the site."""
    join = APIRouter(prefix="/api/control", responses=REFUSALS)

    @join.get("/join", summary="The code by which a camera joins, and cameras without certificates")
    async def state() -> dict[str, Any]:
        return asked(joining.body)

    @join.post("/join", summary="Let one camera join within two minutes")
    async def let() -> dict[str, Any]:
        asked(joining.open)
        return await state()

    return join


def _send(ask: Ask, control: Control) -> Done:
    answer = ask(encode(control))
    if answer is None:
        raise HTTPException(504, "the edge does not answer: it does not run, or allows no control")
    try:
        controlled = decode(answer, Controlled, "edge")
    except InputError as error:
        raise HTTPException(504, str(error)) from None
    if controlled.problem:
        raise HTTPException(409, controlled.problem)
    return Done(said=controlled.said)


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

    @people.get("/people", summary="People who have a name", responses=READ_REFUSALS)
    def named() -> list[dict[str, Any]]:
        return [_body(one) for one in asked(lambda: people_of(place, site, named=True))]

    @people.post("/control/people", summary="Name a person, or choose a colour", responses=REFUSALS)
    def name(request: Request, changes: PersonChanges) -> Done:
        track = changes.run, changes.track
        said = []

        def change() -> None:
            people = () if changes.only else people_of(place, site, named=True)
            tracks = next((one.tracks for one in people if track in one.tracks), (track,))
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


def _body(person: StoredPerson) -> dict[str, Any]:
    return {
        "name": person.name,
        "colour": person.colour,
        "tracks": [{"run": run, "track": track} for run, track in person.tracks],
        "first_ns": person.first_ns,
        "last_ns": person.last_ns,
    }
