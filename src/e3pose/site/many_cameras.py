"""All cameras of a machine in one program, with one copy of each network.

Cameras wait for their turn to look: a look takes one core, and as many go on at a time as there are
cores, which is faster than several looks that share all cores. Where the network runs on a device
of its own, or has threads of its own, one look goes on at a time. Each camera keeps its own
connection, identity, source and threads. One that fails is opened again by itself, and takes no
other with it; but where a source or a network never answers, all end to start again: its thread
takes a core until then.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from e3pose.base.errors import Fault, InputError
from e3pose.camera.live import CameraNode, ProcessorTime, Stuck
from e3pose.detectors import Detector, looks_at_a_time, side_by_side
from e3pose.settings.camera_file import NodeTable, is_camera_file, load_node
from e3pose.settings.resolved import resolve_site
from e3pose.settings.sources import detects
from e3pose.site.camera_program import Camera, load_detector, open_camera
from e3pose.site.program_log import Log
from e3pose.site.run import run_until_stopped
from e3pose.site.up import STEADY_S, camera_keys, longer_s

Key = tuple[str, Path | None, str, int | None]


class Turns:
    """Lets so many cameras look at a time, and knows what processor time all looks took.

    Attributes:
        at_a_time: looks.
        cameras: that share the program.
    """

    def __init__(self, at_a_time: int, cameras: int) -> None:
        """Begin; nobody looks yet."""
        self.at_a_time, self.cameras = at_a_time, cameras
        self._turns, self._lock = threading.Semaphore(at_a_time), threading.Lock()
        self._begun_ns, self._looks_ns = time.process_time_ns(), 0

    @contextmanager
    def turn(self) -> Iterator[Callable[[], int]]:
        """Wait for a turn; yield what returns the processor time taken by it, nanoseconds.

        A look on one core is all on its thread; one that has the machine to itself is charged what
        the program takes meanwhile.
        """
        now_ns = time.thread_time_ns if self.at_a_time > 1 else time.process_time_ns
        with self._turns:
            begun_ns = now_ns()
            try:
                yield lambda: now_ns() - begun_ns
            finally:
                with self._lock:
                    self._looks_ns += now_ns() - begun_ns

    def other_ns(self) -> int:
        """Return a camera's share of the time that no look took."""
        with self._lock:
            passed_ns = time.process_time_ns() - self._begun_ns
            return max(passed_ns - self._looks_ns, 0) // self.cameras


class TurnTime(ProcessorTime):
    """The same of a camera that shares its program; to look, it waits for its turn."""

    def __init__(self, turns: Turns) -> None:
        """Begin."""
        super().__init__()
        self._turns = turns
        self._before_ns = turns.other_ns()

    @property
    def total_s(self) -> float:
        """Seconds so far: its looks, and its share of the rest."""
        return (self._look_ns + self._turns.other_ns() - self._before_ns) / 1e9

    @contextmanager
    def looking(self) -> Iterator[None]:
        """Wait for a turn, and count the turn as looking."""
        with self._turns.turn() as took_ns:
            try:
                yield
            finally:
                self._look_ns += took_ns()


@dataclass(slots=True, eq=False)
class _Seat:
    """One camera, opened again after it failed."""

    node: NodeTable
    log: Log
    camera: Camera | None = None
    error: InputError | None = None
    due_s: float = 0.0
    wait_s: float = 0.0
    opened_s: float = 0.0


class Cameras:
    """Cameras at work in one program, until they are closed. Use it as a context manager.

    Attributes:
        turns: in which they look.
        ended: by name, the node of each camera that was closed last.
    """

    def __init__(self, nodes: Sequence[NodeTable], log_of: Callable[[NodeTable], Log]) -> None:
        """Load the networks, and start all cameras.

        Args:
            nodes: their camera files.
            log_of: returns the log of a camera.

        Raises:
            InputError: when two have one name, or no camera can be opened.
        """
        names = [(node.site, node.camera) for node in nodes]
        if twice := {name for site, name in names if names.count((site, name)) > 1}:
            raise InputError("cameras", f"{min(twice)} twice", "each once")
        if not nodes:
            raise InputError("cameras", "none", "at least one")
        self.ended: dict[str, CameraNode] = {}
        self._detectors: dict[Key, Detector] = {}
        if len(nodes) > 1:  # a meter would measure the whole machine for each camera
            nodes = [replace(node, meter="model") for node in nodes]
        self._seats = [_Seat(node, log_of(node)) for node in nodes]
        for seat in self._seats:
            with suppress(InputError):  # is told when the camera opens
                self._detector(seat.node)
        self.turns = Turns(looks_at_a_time(self._detectors.values()), len(nodes))
        try:
            for seat in self._seats:
                self._open(seat)
            errors = [seat.error for seat in self._seats if seat.error is not None]
            if len(errors) == len(self._seats):
                raise errors[0]
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Cameras:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """See `close`."""
        self.close()

    @property
    def open(self) -> list[str]:
        """Names of the cameras at work."""
        return [seat.node.camera for seat in self._seats if seat.camera is not None]

    def running(self) -> bool:
        """Look after the cameras: open those again that failed; always true."""
        for seat in self._seats:
            now_s = time.monotonic()
            if seat.camera is None:
                if now_s >= seat.due_s:
                    self._open(seat)
            elif not seat.camera.running():
                failure = seat.camera.node.threads.failure
                self._close(seat)
                if isinstance(failure, Stuck):
                    raise failure
                self._put_off(seat, str(failure or "ended"))
            elif now_s - seat.opened_s > STEADY_S:
                seat.wait_s = 0.0
        return True

    def run(self, for_s: float | None = None) -> None:
        """Run until Ctrl-C, SIGTERM, or for a number of seconds; on the main thread."""
        try:
            run_until_stopped(self.running, for_s)
        finally:
            self.close()

    def close(self) -> None:
        """End all, and leave the site."""
        enders = [threading.Thread(target=self._close, args=(seat,)) for seat in self._seats]
        for each in enders:  # at once: each may wait for its source
            each.start()
        for each in enders:
            each.join()

    def _detector(self, node: NodeTable) -> Detector | None:
        """Return the detector of a camera, which others share; None of one without."""
        if detects(node.source):
            return None
        key = (node.detector, node.model, node.provider, node.threads)
        if key not in self._detectors:
            self._detectors[key] = load_for(node, len(self._seats))
        return self._detectors[key]

    def _open(self, seat: _Seat) -> None:
        try:
            detector = self._detector(seat.node)
            seat.camera = open_camera(
                seat.node, seat.log, detector=detector, processor=TurnTime(self.turns)
            )
            seat.opened_s, seat.error = time.monotonic(), None
        except InputError as error:
            seat.error = error
            self._put_off(seat, str(error))

    def _close(self, seat: _Seat) -> None:
        camera, seat.camera = seat.camera, None
        if camera is not None:
            with suppress(Fault):
                camera.close()
            self.ended[seat.node.camera] = camera.node

    def _put_off(self, seat: _Seat, why: str) -> None:
        seat.wait_s = longer_s(seat.wait_s)
        seat.due_s = time.monotonic() + seat.wait_s
        seat.log.warning(f"{why}; the camera starts again in {seat.wait_s:g} s")


def nodes_of(files: Sequence[Path], only: Sequence[str] = ()) -> list[NodeTable]:
    """Return the settings of the cameras that files name.

    Args:
        files: one site file, or its folder, for its cameras that have a source; or camera files.
        only: the cameras to keep; empty for all.

    Raises:
        InputError: naming the file, the key, what was found and what was expected.
    """
    if len(files) == 1 and not is_camera_file(files[0]):
        site = resolve_site(files[0])
        names = [name for name, camera in site.cameras.items() if camera.source is not None]
        nodes = [load_node(None, camera_keys(site, name)) for name in names]
    else:
        nodes = [load_node(path) for path in files]
    names = [node.camera for node in nodes]
    if unknown := set(only) - set(names):
        raise InputError("--only", min(unknown), f"names of {', '.join(names) or 'cameras'}")
    return [node for node in nodes if not only or node.camera in only]


def load_for(node: NodeTable, cameras: int) -> Detector:
    """Load the network of a camera for the program that it shares.

    A look takes one thread where others may go on beside it, else all cores.

    Args:
        node: the camera's settings.
        cameras: in the program.
    """

    def load(threads: int | None) -> Detector:
        return load_detector(replace(node, threads=threads), node.detector)

    return load(node.threads) if node.threads or cameras == 1 else side_by_side(load)
