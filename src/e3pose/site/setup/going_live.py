"""Run the site as `e3pose up --view` does, while the page of the set-up is served."""

from __future__ import annotations

import threading
from contextlib import closing, suppress
from dataclasses import dataclass, field
from typing import Any

from e3pose.base.errors import GaveUp, InputError
from e3pose.base.private import make_folder
from e3pose.settings.resolved import ResolvedSite, resolve_site
from e3pose.site.follow import LOCAL_OPERATOR, Follower, operator_of, viewer_link
from e3pose.site.ready import site_programs
from e3pose.site.setup.session import SetupSession
from e3pose.site.up import run_site
from e3pose.site.web.address import page_links, view_program
from e3pose.wire.codec import decode, encode
from e3pose.wire.network import check_port, open_network
from e3pose.wire.site_messages import Control, Controlled
from e3pose.wire.topics import of_control
from e3pose.wire.transport import Transport

END_S = 30.0
ASK_S = 3.0
MAX_LINES = 20


@dataclass(eq=False)
class LiveSite:
    """The programs of a site at work; its methods may be called on any thread.

    Attributes:
        state: `off`, `starting`, `running`, `ending` or `failed`.
        problem: why it failed.
        lines: what it said.
        url: of the live page, with its token; empty while it does not run.
    """

    state: str = "off"
    problem: str = ""
    lines: list[str] = field(default_factory=list)
    url: str = ""
    _follower: Follower | None = None
    _transport: Transport | None = None
    _site: ResolvedSite | None = None
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    @property
    def on(self) -> bool:
        """Whether its programs run, or begin or end to."""
        return self.state in ("starting", "running", "ending")

    def start(self, setup: SetupSession) -> None:
        """Start the site of a setup.

        Raises:
            InputError: while it runs, or other work does.
        """
        if self.on:
            raise InputError("the site is running: stop it first")
        setup.tasks.check_free()
        site = resolve_site(setup.folder)
        setup.thumbnails.close()
        self.state, self.problem, self.lines, self._stop = "starting", "", [], threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(site,), name="setup-live", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Ask the site to end."""
        if self.on:
            self.state = "ending"
        self._stop.set()

    def close(self) -> None:
        """End the site, and wait for it."""
        self.stop()
        if self._thread is not None:
            self._thread.join(END_S)

    def restart(self, setup: SetupSession) -> None:
        """Restart the site with the present file, or start it."""
        self.close()
        self.start(setup)

    def ask(self, control: Control) -> str:
        """Request a change of the running edge, and return its answer.

        Raises:
            InputError: where it refuses, or does not answer.
        """
        transport, site = self._transport, self._site
        if transport is None or site is None:
            raise InputError("the site does not run")
        return ask_edge(transport, site, LOCAL_OPERATOR, control)

    def body(self) -> dict[str, Any]:
        """Return it for the page."""
        status = None if self._follower is None else self._follower.status
        words = ""
        if self.state == "running" and status is None:
            words = "The edge is starting; a first start compiles for a minute or two."
        elif status is not None and status.compiling_s is not None:
            words = f"The edge is compiling: {status.compiling_s:.0f} s left, at the first start."
        return {
            "state": self.state, "problem": self.problem, "lines": self.lines, "url": self.url,
            "words": words, "live": bool(status is not None and status.compiling_s is None),
            "people": None if status is None else status.people,
        }  # fmt: skip

    def _say(self, line: str) -> None:
        if line:
            self.lines = [*self.lines, line][-MAX_LINES:]

    def _run(self, site: ResolvedSite) -> None:
        try:
            logs = site.file.folder / "logs"
            programs = site_programs(site, logs, warn=self._say)
            page, address = view_program(site, logs, self._say, fixed=False)
            programs.append(page)
            with suppress(OSError):  # programs then run without logs
                make_folder(logs)
            with closing(open_network(viewer_link(site.file, None, operates=True))) as transport:
                self._follower = Follower(site.file.name)
                self._follower.listen(transport)
                self._transport, self._site = transport, site
                self.url = page_links(site.file, address)[1].partition(": ")[2].strip()
                self.state = "ending" if self._stop.is_set() else "running"
                run_site(programs, self._stop.is_set, self._say)
            self.state = "off"
        except (InputError, OSError, GaveUp) as error:
            self.state, self.problem = "failed", str(error)
        finally:
            self.url = ""
            self._follower = self._transport = self._site = None
            if self.on:
                self.state = "off"


def runs_elsewhere(site: ResolvedSite) -> bool:
    """Return whether another program of this machine uses the port of the site's edge."""
    try:
        check_port(site.file.link.endpoint)
    except InputError:
        return True
    return False


def ask_elsewhere(site: ResolvedSite, control: Control) -> str:
    """Ask an edge that another program started; see `LiveSite.ask`."""
    link = viewer_link(site.file, None, operates=True)
    operator = operator_of(link)
    if operator is None:
        raise InputError("the running edge takes orders of operators only: e3pose keys add setup "
                         "--operator")  # fmt: skip
    with closing(open_network(link)) as transport:
        return ask_edge(transport, site, operator, control)


def ask_edge(transport: Transport, site: ResolvedSite, operator: str, control: Control) -> str:
    """Send an order to an edge; return its answer, raise `InputError` if it refuses."""
    answer = transport.ask(of_control(site.file.name, operator), encode(control), ASK_S)
    if answer is None:
        raise InputError("the edge does not answer: it is still starting, or allows no control")
    said = decode(answer, Controlled, "edge")
    if said.problem:
        raise InputError(said.problem)
    return said.said
