"""The API of the set-up: small questions and orders, each refused in the command line's words.

The state of the page is the site, its steps with commands, and the jobs.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

from fastapi import APIRouter, FastAPI, HTTPException, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import Field

from e3pose import __version__
from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.base.quantities import plural, shell
from e3pose.site.setup import cameras, networks, settings, solving, walking
from e3pose.site.setup.coverage import Coverage
from e3pose.site.setup.going_live import LiveSite
from e3pose.site.setup.plan import Plan
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.settings import Asked, Name
from e3pose.site.web.app import unreadable
from e3pose.site.web.page import BROWSER, FILES, make_page

Text = Annotated[str, Field(max_length=500)]


class ChosenSite(Asked):
    """A site: one that is there, a new one, or a finished example."""

    name: Name
    kind: Literal["known", "new", "example"] = "known"


class Sources(Asked):
    """Sources of cameras."""

    sources: Annotated[list[Text], Field(min_length=1, max_length=32)]


class CameraChange(Asked):
    """Another name or turn of a camera, or its end."""

    name: Name | None = None
    rotation: Annotated[int | None, Field(ge=0, le=270)] = None
    remove: bool = False


class Phone(Asked):
    """A phone to add as a camera."""

    name: Name


class NetworkLogin(Asked):
    """A camera of the network, and who asks for its streams."""

    host: Name
    user: Annotated[str, Field(max_length=64)] = ""
    password: Annotated[str, Field(max_length=128)] = ""


class Height(Asked):
    """Height of the person who walked; 0 if unknown."""

    height_cm: Annotated[float, Field(ge=0, le=300)] = 0.0


class Click(Asked):
    """A place in the picture of a camera, pixels of the full image."""

    camera: Name
    x: Annotated[float, Field(ge=0, le=1e5)]
    y: Annotated[float, Field(ge=0, le=1e5)]
    what: Literal["origin", "x-axis"]


class LiveOrder(Asked):
    """Whether the site is to run."""

    order: Literal["start", "stop", "restart"]


@dataclass(eq=False)
class Table:
    """Everything that the API works with.

    Attributes:
        setup: the site that is set up.
        live: its programs.
        snapshots: pictures of the newest walk.
        covered: what that walk covers; None before one.
    """

    setup: SetupSession
    live: LiveSite = field(default_factory=LiveSite)
    snapshots: walking.Snapshots = field(default_factory=walking.Snapshots)
    covered: Coverage | None = None

    def free(self) -> None:
        """Raise `InputError` while the site runs, which has the cameras then."""
        if self.live.on:
            raise InputError("the site is running and has its cameras: stop it first")

    def start_live(self) -> None:
        """Start the site; the pictures of its walk have served."""
        self.live.start(self.setup)
        self.snapshots.pictures.clear()
        walking.forget_pictures(self.setup.folder)

    def state(self) -> dict[str, Any]:
        """Return where the set-up stands, which is the answer to all that changes it."""
        return state_of(self.setup, self.live)

    def close(self) -> None:
        """End all work, all programs, and all sources."""
        self.setup.tasks.close()
        self.live.close()
        self.setup.thumbnails.close()


def setup_app(table: Table) -> FastAPI:
    """Return the application of the set-up, without its door."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        yield

    app = FastAPI(
        title="e3pose setup", version=__version__, lifespan=life,
        docs_url=None, redoc_url=None, openapi_url=None,
    )  # fmt: skip
    app.add_exception_handler(RequestValidationError, unreadable)
    app.add_exception_handler(InputError, _refused)
    app.add_exception_handler(OSError, _refused)
    page = BROWSER.joinpath("setup.html").read_bytes()
    app.include_router(make_page({**FILES, "/": page}))
    app.include_router(_sites(table))
    app.include_router(_cameras(table))
    app.include_router(_steps(table))
    return app


async def _refused(_: Request, error: Exception) -> JSONResponse:
    """Return the error in the words of the command line."""
    words = str(error)
    if isinstance(error, OSError) and error.strerror:
        words = f"{error.filename or 'file'}: {error.strerror.lower()}"
    return JSONResponse({"detail": masked(words)[:1000]}, 409)


def _sites(table: Table) -> APIRouter:
    api, setup = APIRouter(prefix="/api/setup"), table.setup

    @api.get("/state")
    def state() -> dict[str, Any]:
        return table.state()

    @api.post("/site")
    def choose(asked: ChosenSite) -> dict[str, Any]:
        table.free()
        if asked.kind == "example":
            cameras.make_example_site(setup, asked.name)
        else:
            setup.choose(asked.name, asked.kind == "new")
        table.covered = None
        table.snapshots.pictures.clear()
        return table.state()

    @api.post("/site/leave")
    def leave() -> dict[str, Any]:
        table.free()
        setup.tasks.check_free()
        setup.thumbnails.close()
        setup.name = ""
        return table.state()

    @api.post("/stop")
    def stop() -> dict[str, Any]:
        setup.tasks.stop()
        return table.state()

    @api.get("/settings")
    def present() -> dict[str, Any]:
        return settings.present(setup)

    @api.post("/settings")
    def change(asked: settings.Wanted) -> dict[str, Any]:
        return settings.change_settings(setup, table.live, asked)

    @api.post("/settings/before")
    def before() -> dict[str, Any]:
        return settings.take_before(setup, table.live)

    @api.post("/live")
    def live(asked: LiveOrder) -> dict[str, Any]:
        orders: dict[str, Callable[[], None]] = {
            "start": table.start_live,
            "stop": table.live.stop,
            "restart": lambda: table.live.restart(setup),
        }
        orders[asked.order]()
        return table.state()

    return api


def _cameras(table: Table) -> APIRouter:
    api, setup = APIRouter(prefix="/api/setup"), table.setup

    @api.get("/found")
    def found() -> dict[str, Any]:
        return cameras.found(setup)

    @api.post("/cameras")
    def add(asked: Sources) -> dict[str, Any]:
        table.free()
        cameras.start_adding(setup, asked.sources)
        return table.state()

    @api.post("/cameras/{camera_id}")
    def change(camera_id: str, asked: CameraChange) -> dict[str, Any]:
        table.free()
        cameras.change_camera(setup, camera_id, asked.name, asked.rotation, asked.remove)
        return table.state()

    @api.post("/phones")
    def add_phone(asked: Phone) -> dict[str, Any]:
        table.free()
        return cameras.add_phone(setup, asked.name)

    @api.post("/phones/{camera_id}")
    def show_code(camera_id: str) -> dict[str, Any]:
        return cameras.show_code(setup, camera_id)

    @api.get("/cameras/{camera_id}/picture")
    def picture(camera_id: str) -> dict[str, Any]:
        task = setup.tasks.newest
        if setup.tasks.busy and task is not None and task.kind in ("walk", "second"):
            return walking.newest_view(table.covered, table.snapshots, camera_id)
        if setup.tasks.busy or table.live.on:
            raise HTTPException(409, "other work has the cameras at present")
        return asdict(cameras.thumbnail_of(setup, camera_id))

    @api.post("/look")
    def look() -> dict[str, Any]:
        cameras.start_looking(setup)
        return table.state()

    @api.post("/streams")
    def streams(asked: NetworkLogin) -> dict[str, Any]:
        return cameras.ask_streams(setup, asked.host, asked.user, asked.password)

    @api.post("/simulate")
    def simulate() -> dict[str, Any]:
        cameras.start_simulating(setup)
        return table.state()

    return api


def _steps(table: Table) -> APIRouter:
    api, setup = APIRouter(prefix="/api/setup"), table.setup

    @api.get("/networks")
    def listed() -> list[dict[str, Any]]:
        return networks.networks(setup)

    @api.post("/networks/{name}/{order}")
    def network(name: str, order: Literal["pull", "time", "use"]) -> dict[str, Any]:
        if order != "pull":
            table.free()
        start = {
            "pull": networks.start_pulling,
            "time": networks.start_timing,
            "use": networks.start_using,
        }
        start[order](setup, name)
        return table.state()

    @api.post("/record/{which}")
    def record(which: walking.Which) -> dict[str, Any]:
        table.free()
        table.covered = walking.start_walk(setup, which, table.snapshots)
        return table.state()

    @api.get("/covered")
    def covered() -> dict[str, Any]:
        if table.covered is None:
            raise HTTPException(404, "no walk was recorded yet")
        return walking.body(table.covered)

    @api.post("/solve")
    def solve(asked: Height) -> dict[str, Any]:
        solving.start_solving(setup, asked.height_cm)
        return table.state()

    @api.get("/overlays")
    def overlays() -> dict[str, Any]:
        if not table.snapshots.pictures:  # `e3pose setup` was started again after the walk
            table.snapshots.load(setup.folder)
        return solving.overlays(setup, table.snapshots)

    @api.post("/world")
    def world(asked: Click) -> dict[str, Any]:
        table.free()
        command = solving.move_world(setup, asked.camera, asked.x, asked.y, asked.what)
        return {"command": command}

    @api.post("/check")
    def check() -> dict[str, Any]:
        solving.start_checking(setup)
        return table.state()

    return api


def state_of(setup: SetupSession, live: LiveSite) -> dict[str, Any]:
    """Return all that the page shows but pictures, lists of networks, and settings."""
    task = setup.tasks.newest
    body: dict[str, Any] = {
        "root": str(setup.root),
        "sites": setup.sites(),
        "site": setup.name,
        "task": None if task is None else task.body(),
        "live": live.body(),
    }
    if not setup.name:
        return body
    plan = setup.plan()
    results = setup.results()
    return {
        **body,
        "made": setup.has_site,
        "cameras": [
            {
                "id": c.id, "source": cameras.shown_source(setup, c.source), "rotation": c.rotation,
                "width": c.width, "height": c.height, "fps": c.fps, "announced": c.announced,
            }
            for c in plan.cameras
        ],
        "detector": plan.detector,
        "height_cm": plan.height_cm,
        "walk": results.get("walk"),
        "second": results.get("second"),
        "solve": results.get("solve"),
        "check": results.get("check"),
        "commands": {"simulate": cameras.simulate_command(setup)},
        "steps": _steps_of(setup, plan, results, live),
    }  # fmt: skip


def _steps_of(
    setup: SetupSession, plan: Plan, results: dict[str, Any], live: LiveSite
) -> list[dict[str, Any]]:
    """Return the steps: whether each is done, whether it can begin, its command, and words."""
    written = setup.has_site and [c.was for c in plan.cameras] == [c.id for c in plan.cameras]
    placed = written and setup.placed()
    walked = bool(plan.walk) or placed
    checked = results.get("check") is not None
    few = len(plan.cameras) < 2
    rows = (
        ("cameras", "Cameras", not few, True, networks.init_command(setup, plan.detector),
         plural(len(plan.cameras), "camera") if plan.cameras else "none yet"),
        ("network", "Network", written, not few, networks.init_command(setup, plan.detector),
         plan.detector if written else "changes are not written yet" if setup.has_site else ""),
        ("walk", "Walk", walked, written, walking.record_command(setup, "walk"),
         "recorded" if plan.walk else "calibrated already" if placed else ""),
        ("solve", "Solve", placed, bool(plan.walk) or placed,
         solving.solve_command(setup, plan.height_cm), "cameras placed" if placed else ""),
        ("check", "Check", checked, placed, f"{walking.record_command(setup, 'second')}\n"
         f"{solving.check_command(setup)}", "" if not checked else results["check"]["grade"]),
        ("live", "Go live", live.body()["live"], placed, f"e3pose up {shell(setup.name)} --view",
         live.state if live.on else ""),
        ("change", "Change", False, setup.has_site, f"e3pose check {shell(setup.name)}", ""),
    )  # fmt: skip
    return [
        {"id": key, "title": title, "done": done, "open": opened, "command": command, "words": says}
        for key, title, done, opened, command, says in rows
    ]
