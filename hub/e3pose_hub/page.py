"""The hub's page: users see the state of their sites and open the live pages of these."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib import resources
from typing import Any

import msgspec
from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import Engine

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.base.version import Watched
from e3pose.site.web.access import Rules, token_of
from e3pose.site.web.address import listening_at
from e3pose.site.web.page import FILES as FILES_OF_SITE
from e3pose.site.web.page import make_page
from e3pose.site.web.server import PageServer, https_of, serve
from e3pose.store.database import REFUSALS, refusal_of
from e3pose.wire.endpoint import read_host_port
from e3pose_hub.accesses import log_accesses
from e3pose_hub.database import open_hub
from e3pose_hub.overview import Overviews
from e3pose_hub.settings import LISTEN, Hub
from e3pose_hub.users import User, Users, read_users, users_of

BROWSER = resources.files("e3pose_hub").joinpath("browser")
# Its own, and the modules and styles of a site's page.
FILES = {
    **FILES_OF_SITE,
    "/": BROWSER.joinpath("sites.html").read_bytes(),
    "/sites.js": BROWSER.joinpath("sites.js").read_bytes(),
    "/sites.css": BROWSER.joinpath("sites.css").read_bytes(),
}
KEPT = 4  # connections to a server's database
OPENS_PER_S, OPEN_BURST = 0.5, 20.0  # sites that somebody opens: each is logged
OPEN_PATHS = frozenset(FILES) | {"/favicon.ico"}  # they hold nothing of any site


class Opening(BaseModel):
    """A request for the address of a site's live page."""

    model_config = ConfigDict(extra="forbid")
    site: str = Field(max_length=100)


def open_page(
    hub: Hub, listen: str | None = None, report: Callable[[str], object] = print
) -> PageServer:
    """Serve the page over sites until it is closed.

    Args:
        hub: its file.
        listen: in place of the file's `HOST:PORT`.
        report: called with messages for operators.

    Raises:
        InputError: for a port that is taken, an address beyond this machine without a certificate,
            and all that is wrong in the files.
    """
    table = hub.view
    at = table.listen if listen is None else read_host_port(listen, "view.listen", LISTEN)
    host, port = at.host, at.port
    secure, watched = None, list[Watched]()
    if table.certificate:
        files = hub.path.parent / table.certificate, hub.path.parent / table.key
        try:
            secure, renewal = https_of(files, report)
        except OSError as error:
            found = f"{table.certificate} and {table.key} ({error})"
            wanted = "PEM files of a certificate and its key"
            raise InputError("view.certificate, view.key", found, wanted, str(hub.path)) from None
        watched.append(renewal)
    elif not at.here_alone and not table.insecure:
        wanted = "127.0.0.1:PORT, or certificate and key under [view] for https"
        raise InputError("view.listen", at.place, wanted, str(hub.path))
    users = users_of(hub)
    read_users(users.path)  # what is wrong in it is told at once
    hosts = frozenset({"localhost", host.lower(), *(name.lower() for name in table.hosts)})
    rules = Rules(
        users,
        hosts,
        False,
        secure is not None,
        frozenset(table.proxies),
        open_paths=OPEN_PATHS,
        personal=True,
    )
    engine = open_hub(hub.database, KEPT)
    with ExitStack() as stack:
        stack.callback(engine.dispose)
        listening = listening_at(host, port)
        stack.callback(listening.close)
        serving = serve(make_app(hub, engine, users), rules, listening, secure)
        stack.callback(serving.close)
        scheme, at = "http" if secure is None else "https", listening.getsockname()[1]
        return PageServer(f"{scheme}://{host}:{at}/", serving, stack.pop_all(), tuple(watched))


def make_app(hub: Hub, engine: Engine, users: Users) -> FastAPI:
    """Return the application, without its door."""
    app = FastAPI(title="e3pose hub", docs_url=None, redoc_url=None, openapi_url=None)
    overviews, opens = Overviews(engine, hub), Rate(OPENS_PER_S, OPEN_BURST, time.monotonic)

    def user_of(request: Request) -> tuple[User, list[str]]:
        user = users.of_token(token_of(request.headers))
        if user is None:  # revoked since the door was passed
            raise HTTPException(401, "wrong token")
        return user, [n for n, site in hub.sites.items() if site.group in user.groups]

    @app.get("/api/sites")
    def sites(request: Request) -> Response:
        user, names = user_of(request)
        try:
            now_ns, found = overviews.of(names, time.time_ns())
        except REFUSALS as error:
            raise HTTPException(503, f"the hub's database: {refusal_of(error)}") from None
        body = {"user": user.name, "role": user.role, "now_ns": now_ns, "sites": found}
        return Response(msgspec.json.encode(body), media_type="application/json")

    @app.post("/api/open")
    def go(asked: Opening, request: Request) -> dict[str, str]:
        user, names = user_of(request)
        if asked.site not in names:  # the same for those of others and those that are none
            raise HTTPException(404, "no site of that name in your groups")
        if wait_s := opens.wait_s(user.name):
            raise HTTPException(429, "too many sites opened", {"Retry-After": f"{wait_s:.0f}"})
        try:
            url, how = _page_of(hub, asked.site, user)
            log_accesses(engine, user.name, [asked.site], how)
        except InputError as error:
            raise HTTPException(409, str(error)) from None
        return {"url": url}

    app.include_router(make_page(FILES))
    return app


def _page_of(hub: Hub, name: str, user: User) -> tuple[str, str]:
    """Return the address of a site's page for somebody, and what to log."""
    site = hub.sites[name]
    if not site.page:
        raise InputError(f"{name}: page: not found, expected the address of its live page")
    if not site.page_users:
        return site.page, "live page, by a token of their own"
    how = "control" if user.role == "operator" else "see"
    return f"{site.page}#token={user.page_token(name)}", f"live page, to {how}"


def page_lines(url: str, hub: Hub) -> list[str]:
    """Return the lines printed at the start of the page."""
    names: list[Any] = [user.name for user in read_users(users_of(hub).path)]
    if not names:
        return [
            f"See the sites: {url}",
            "Nobody may yet: e3pose hub grant HUB NAME --viewer --group GROUP",
        ]
    return [f"See the sites: {url}#token=TOKEN, with the token of {', '.join(names)[:200]}"]
