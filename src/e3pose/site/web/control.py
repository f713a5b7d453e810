"""The control part of the API: requests are forwarded to the edge, which decides."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException
from pydantic import BaseModel, ConfigDict, Field

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.site.joining import Joining
from e3pose.site.web.api import asked
from e3pose.site.web.schemas import Refused, Shape
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Control, Controlled

Ask = Callable[[bytes], bytes | None]
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
    """How cameras are selected; `cameras` and `target_error_mm` replace each other."""

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
        return _send(
            ask,
            Control(
                cameras=changes.cameras,
                target_error_mm=changes.target_error_mm,
                quality_weight=changes.quality_weight,
            ),
        )

    @control.post("/cameras/{camera_id}", summary="Pause a camera, or set its budget")
    def camera(camera_id: str, changes: CameraChanges) -> Done:
        try:
            check_camera_id(camera_id)
        except InputError as error:
            raise HTTPException(422, str(error)) from None
        return _send(
            ask, Control(camera_id=camera_id, paused=changes.paused, budget=changes.budget)
        )

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
