"""Several edges in one process; each starts, fails and restarts by itself."""

from __future__ import annotations

import os
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.threads import show_thread_name
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.edge_program import Edge, start_edge
from e3pose.site.program_log import Log
from e3pose.site.run import reduce_pauses, run_until_stopped
from e3pose.site.summary import edge_summary

EVERY_S = 0.2  # between two looks at an edge
START_S = 180.0  # a site waits so long for another that starts: the first compiles for all
FIRST_WAIT_S, LONGEST_WAIT_S = 2.0, 60.0  # before a site is started again; doubled if that fails
STEADY_S = 60.0  # an edge that ran for so long has recovered
END_S = 30.0  # for all sites to save what they have
END_STARTING_S = 2.0  # for one that starts, and has nothing to save
Load = Callable[[Path], ResolvedSite]


class Keeper:
    """Keeps the edge of one site running, on its own thread.

    Attributes:
        path: of the site file, which is read at each start.
        tried: set when the first start was made, or failed.
        summary: lines about the last run of the edge; empty before its end.
    """

    def __init__(self, path: Path, load: Load, log: Log, starting: threading.Lock) -> None:
        """Do nothing before `start`.

        Args:
            path: of the site file.
            load: reads it.
            log: gets messages for operators.
            starting: held by the one that starts.
        """
        self.path, self.tried, self.summary = path, threading.Event(), list[str]()
        self._load, self._log, self._starting = load, log, starting
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)

    def start(self) -> None:
        """Start the edge, and again when it fails."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the edge to end."""
        self._stop.set()

    def join(self, timeout_s: float) -> bool:
        """Wait until it has ended; return whether it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        show_thread_name()
        wait_s, why = FIRST_WAIT_S, ""
        while not self._stop.is_set():
            begun_s, about = time.monotonic(), dict[str, str]()
            try:
                self._work(why)
            except InputError as error:
                why = str(error)
            except Exception as error:  # one site must not end the others
                why, about = f"{type(error).__name__}: {error}", {"where": where(error)}
            self.tried.set()
            if self._stop.is_set():
                return
            if time.monotonic() - begun_s > STEADY_S:
                wait_s = FIRST_WAIT_S
            told = "site stopped, and is started again"
            self._log.warning(told, error=why, after_s=wait_s, **about)
            self._stop.wait(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _work(self, before: str) -> None:
        """Run the edge until it is stopped; its exceptions propagate."""
        edge = self._open()
        if edge is None:
            return
        with edge:
            if before:
                edge.server.event_log.report("restarted", f"site started again after: {before}")
            self.tried.set()
            while not self._stop.wait(EVERY_S) and edge.running():
                pass
            edge.server.stop()
            if (failure := edge.server.threads.failure) is not None:
                raise failure
            counts = edge.server.counts
            self.summary = edge_summary(edge.status(), counts.slots, counts.views)

    def _open(self) -> Edge | None:
        """Start the edge, when it is its turn; None when it is to stop before."""
        until_s = time.monotonic() + START_S
        while not (alone := self._starting.acquire(timeout=EVERY_S)):
            if self._stop.is_set():
                return None
            if time.monotonic() > until_s:  # who starts now hangs
                break
        try:
            return start_edge(self._load(self.path), self._log, WallClock())
        finally:
            if alone:
                self._starting.release()


def where(error: BaseException) -> str:
    """Return the lines of code that an error comes from, the innermost last."""
    frames = traceback.extract_tb(error.__traceback__)[-3:]
    return " > ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in frames)


def load_apart(paths: Sequence[Path], load: Load) -> None:
    """Read site files, and make sure that nothing of a site is another's as well.

    A file that cannot be read stops no other site, and is told when its site is started.

    Args:
        paths: of the files.
        load: reads one.

    Raises:
        InputError: when two share what is one's own, or none can be used.
    """
    sites, problems = list[ResolvedSite](), list[InputError]()
    for path in paths:
        try:
            sites.append(load(path))
        except InputError as error:
            problems.append(error)
    if not sites:
        raise problems[0]
    check_apart(sites)


def check_apart(sites: Sequence[ResolvedSite]) -> None:
    """Raise `InputError` if two sites share a name, a port, keys, a state or a folder."""
    owners = dict[tuple[str, object], ResolvedSite]()
    for site in sites:
        for thing, kind, value, shown in _own(site):
            owner = owners.setdefault((kind, value), site)
            if owner is not site:
                found = f"{shown}, which {owner.file.path} has as well"
                raise InputError(thing, found, "one for each site").at(site.file.path)


def _own(site: ResolvedSite) -> list[tuple[str, str, object, str]]:
    """Return the settings that no two sites may share: key, kind and value, as text."""
    port = site.file.link.endpoint.port
    own: list[tuple[str, str, object, str]] = [
        ("name", "name", site.file.name, site.file.name),
        ("link.endpoint", "port", port, f"port {port}"),
    ]
    if site.file.metrics_port is not None:
        shown = f"port {site.file.metrics_port}"
        own.append(("metrics_port", "port", site.file.metrics_port, shown))
    records = any(camera.record for camera in site.cameras.values())
    for thing, place in (
        ("link.keys", site.file.link.keys),
        ("state", site.file.state),
        ("learn", site.file.learn),
        ("record.path", site.file.record.path if records else None),
    ):
        if place is not None:
            own.append((thing, thing, os.path.realpath(place), str(place)))
    return own


def run_edges(
    paths: Sequence[Path], load: Load, log: Callable[[Path], Log], for_s: float | None = None
) -> tuple[list[str], bool]:
    """Run the edges of several sites until Ctrl-C, SIGTERM, or for a number of seconds.

    To be called on the main thread.

    Args:
        paths: of the site files.
        load: reads one.
        log: returns who gets the messages of a site.
        for_s: None for without end.

    Returns:
        A summary, to be printed, and whether all have ended. What starts compiles, and cannot be
        asked to end: it ends with the process, which then must not wait for it.

    Raises:
        InputError: when two sites share what is one's own, or none can be used.
    """
    logs = {path: log(path) for path in paths}
    load_apart(paths, load)
    starting = threading.Lock()
    keepers = [Keeper(path, load, logs[path], starting) for path in paths]
    idle, settled = list(keepers), False

    def running() -> bool:
        nonlocal settled
        while idle:  # not before Ctrl-C is listened to
            idle.pop(0).start()
        if not settled and all(keeper.tried.is_set() for keeper in keepers):
            settled = True
            reduce_pauses()
        return True

    run_until_stopped(running, for_s)
    for keeper in keepers:
        keeper.stop()
    stopped_s, lines, all_ended = time.monotonic(), list[str](), True
    for keeper in keepers:
        end_s = stopped_s + (END_S if keeper.tried.is_set() else END_STARTING_S)
        ended = keeper.join(max(0.0, end_s - time.monotonic()))
        late = "did not end" if keeper.tried.is_set() else "ended while it started"
        said = keeper.summary or ["no slots" if ended else late]
        lines += [f"{keeper.path}: {said[0]}", *said[1:]]
        all_ended = all_ended and ended
    return lines, all_ended
