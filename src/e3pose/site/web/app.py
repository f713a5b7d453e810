"""The web application of one site, behind its access control."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI, HTTPException, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse

from e3pose import __version__
from e3pose.site.joining import Joining
from e3pose.site.web.api import REFUSALS, asked, make_api, needed
from e3pose.site.web.control import Ask, make_control, make_join, make_people, make_tests
from e3pose.site.web.feed import Feed, make_live
from e3pose.site.web.keep import Keeping, make_keep
from e3pose.site.web.page import make_page
from e3pose.site.web.pictures import PictureRules
from e3pose.store import Store

TEXT = """Poses, slots and status of a site. Lengths are in metres, z is up, times are nanoseconds
since 1970 by the edge's clock, missing is null. The WebSocket `/api/live?format=json|msgpack` sends
the same events as `GET /api/live`."""

MAX_FAULTS = 5  # named in an answer
Nanoseconds = Annotated[int, Query(ge=0, le=2**62, description="nanoseconds since 1970")]
LONGEST_NS = 8 * 86_400 * 10**9


@dataclass(frozen=True, slots=True, eq=False)
class PageContent:
    """The content of a page.

    Attributes:
        feed: the newest.
        store: what is kept; None where nothing is.
        describe: what does not change.
        ask: sends a `Control` to the edge; None where that is not possible from here.
        pictures: the route of pictures; None where they are off.
        picture_rules: who is shown them.
        log: called with a line about what operators changed here.
        keep: clips, files and recordings; None without.
        test: has a test notice sent and returns how it went; None where nothing is told.
        active_w: by camera, what an active one draws.
        joining: lets cameras join; None where that is not possible from here.
    """

    feed: Feed
    store: Store | None
    describe: Callable[[], dict[str, Any]]
    ask: Ask | None = None
    pictures: APIRouter | None = None
    picture_rules: PictureRules = field(default_factory=PictureRules)
    log: Callable[[str], object] = lambda line: None
    keep: Keeping | None = None
    test: Callable[[], list[str]] | None = None
    active_w: Mapping[str, float] = field(default_factory=dict)
    joining: Joining | None = None

    def body(self, scope: str) -> dict[str, Any]:
        """Return the constant facts of a site, and the permissions of a token's scope."""
        return {
            **self.describe(),
            "scope": scope,
            "stored": self.store is not None,
            "controls": self.ask is not None,
            "tests": self.test is not None,
            "joins": self.joining is not None,
            "recorded": self.keep is not None and self.keep.recordings is not None,
            "pictures": self.picture_rules.for_scope(scope),
        }


def make_app(content: PageContent) -> FastAPI:
    """Return the application of a site, without its door."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        content.feed.attach(asyncio.get_running_loop())
        watching = asyncio.create_task(content.feed.watch())
        yield
        watching.cancel()
        content.feed.attach(None)

    # Its own pages of documentation would load scripts from the internet.
    app = FastAPI(
        title="e3pose", version=__version__, description=TEXT, lifespan=life,
        docs_url=None, redoc_url=None, openapi_url="/api/openapi.json",
    )  # fmt: skip
    app.add_exception_handler(RequestValidationError, unreadable)
    app.include_router(make_page())
    app.include_router(make_live(content.feed))
    if content.ask is not None:
        app.include_router(make_control(content.ask))
    if content.test is not None:
        app.include_router(make_tests(content.test, content.log))
    if content.joining is not None:
        app.include_router(make_join(content.joining))
    if content.pictures is not None:
        app.include_router(content.pictures)
    app.include_router(make_day(content.store, content.active_w))
    feed, place = content.feed, None if content.store is None else content.store.place
    app.include_router(make_people(place, feed.site, feed.look_at_names, content.log))
    app.include_router(make_keep(content.keep or Keeping(place, feed.site, log=content.log)))
    app.include_router(make_api(content.feed, content.store, content.body))
    return app


async def unreadable(_: Request, error: Exception) -> JSONResponse:
    """Say what cannot be read, without repeating it: NaN cannot be, nor lists in lists in lists."""
    assert isinstance(error, RequestValidationError)
    faults = [
        f"{'.'.join(str(part)[:60] for part in fault['loc'][1:]) or 'body'}: {fault['msg'][:120]}"
        for fault in error.errors()[:MAX_FAULTS]
    ]
    return JSONResponse({"detail": "; ".join(faults)}, 422)


def make_day(store: Store | None, active_w: Mapping[str, float]) -> APIRouter:
    """Return the routes about periods: coverage of the store, energy spent and saved.

    Args:
        store: of the site; None where nothing is stored.
        active_w: by camera, what an active one draws.
    """
    day = APIRouter(prefix="/api", responses=REFUSALS)

    @day.get("/timeline", summary="Stored and blind slots in equal parts of a time")
    def timeline(
        start: Nanoseconds,
        end: Nanoseconds,
        parts: Annotated[int, Query(ge=1, le=2000, description="of the time")] = 300,
    ) -> dict[str, list[int]]:
        _check(start, end)
        slots, blind = asked(lambda: needed(store).coverage(start, end, parts))
        return {"slots": slots, "blind": blind}

    @day.get("/spent", summary="What each camera spent in a time, and what all of them saved")
    def spent_of(start: Nanoseconds, end: Nanoseconds) -> dict[str, Any]:
        _check(start, end)
        spent = asked(lambda: needed(store).spent(start, end))
        saved = asked(lambda: needed(store).saved(start, end, active_w))
        return {
            "cameras": [one._asdict() for one in spent],
            "whole_camera": None if saved is None else asdict(saved),
        }

    return day


def _check(start: int, end: int) -> None:
    if not start < end <= start + LONGEST_NS:
        raise HTTPException(422, "end: expected after start, by eight days at most")
