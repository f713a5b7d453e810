"""Periodic work of an edge: status, checkpoint, camera events, and the watchdog.

The watchdog makes an edge that is connected and yet useless leave its network and join it again.
Counters of both sides say so: heartbeats arrive, but orders reach no camera, or views that cameras
send do not arrive; or cameras are present and nothing arrives at all. Cameras that are gone,
asleep, slow, or whose detectors hang are no such case: their own counters say so.
"""

from __future__ import annotations

import faulthandler
import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import file_mode, make_folder
from e3pose.base.system import open_new
from e3pose.edge.camera_state import CONNECTING, SILENT_S, CameraState, State
from e3pose.edge.checkpoint import Checkpoint
from e3pose.edge.membership import Membership
from e3pose.edge.reports import Conditions, RunningEdge, camera_changes, site_status
from e3pose.wire import topics
from e3pose.wire.codec import encode
from e3pose.wire.messages import RESTING
from e3pose.wire.transport import Transport

STALL_S = 3.0  # without any progress
LEAST_ORDERS = 4  # that must have gone unanswered meanwhile
LEAST_SENT = 2  # views that a camera says it sent, and that did not arrive
WAIT_S, LONGEST_WAIT_S = 10.0, 640.0  # between two alarms, doubled each time
SETTLED_S = 1.0  # after a view, a heartbeat has counted it: before, it is no lost one
CALM_S = 60.0  # without an alarm after its time: the next one waits for `WAIT_S` again
MAX_FILES = 5  # of stacks; the oldest is replaced
MAX_BYTES = 256 * 1024


@dataclass(frozen=True, slots=True)
class CameraSigns:
    """Signs of life of one camera.

    Attributes:
        present: whether its program is connected.
        heard_ns: arrival of its newest message; None before the first.
        fresh: whether its heartbeats arrive.
        session: of its program.
        orders: how many it received, by its newest heartbeat.
        sent: how many views it sent, by its newest heartbeat.
        views: how many of them arrived, in time or late.
        due: how many were ordered in time, and are due.
    """

    present: bool
    heard_ns: int | None
    fresh: bool = False
    session: int = 0
    orders: int = 0
    sent: int = 0
    views: int = 0
    due: int = 0


@dataclass(frozen=True, slots=True)
class Progress:
    """Times of a camera's last received order and last arrived view.

    Attributes:
        signs: at that time.
        orders_ns: when its count of orders last rose.
        slots: that had been given orders by then.
        views_ns: when a view last arrived.
    """

    signs: CameraSigns
    orders_ns: int
    slots: int
    views_ns: int


@dataclass(frozen=True, slots=True)
class StallWatch:
    """The progress of all cameras; a value.

    Attributes:
        progress: by camera.
        due_ns: no alarm before this time.
        wait_s: how long the alarm after the next one waits.
        looked_ns: when it looked last; None before the first time.
    """

    progress: tuple[Progress, ...] = ()
    due_ns: int = 0
    wait_s: float = WAIT_S
    looked_ns: int | None = None


def watch_for_stall(
    watch: StallWatch,
    cameras: Sequence[CameraSigns],
    slots: int,
    sending_ns: int | None,
    now_ns: int,
) -> tuple[StallWatch, str]:
    """Return the watch at a later time, and why the edge must rejoin; empty if it need not.

    Args:
        watch: before.
        cameras: `(num_cameras,)` what is known of them.
        slots: for which orders were given so far.
        sending_ns: since when one message has been being sent; None if none is.
        now_ns: the time.
    """
    if watch.looked_ns is not None and now_ns - watch.looked_ns >= STALL_S * 1e9:
        # The machine was suspended, or its clock moved: what is old says nothing.
        due_ns = max(watch.due_ns, now_ns + round(STALL_S * 1e9))
        watch = replace(watch, progress=(), due_ns=due_ns)
    before = watch.progress or tuple(Progress(c, now_ns, slots, now_ns) for c in cameras)
    progress = tuple(
        _progress(one, camera, slots, now_ns) for one, camera in zip(before, cameras, strict=True)
    )
    watch = replace(watch, progress=progress, looked_ns=now_ns)
    if now_ns < watch.due_ns:
        return watch, ""
    why = _stall(progress, cameras, slots, sending_ns, now_ns)
    if not why:
        calm = now_ns - watch.due_ns >= CALM_S * 1e9
        return (replace(watch, wait_s=WAIT_S) if calm else watch), ""
    wait_s = min(2 * watch.wait_s, LONGEST_WAIT_S)
    return StallWatch((), now_ns + round(watch.wait_s * 1e9), wait_s, now_ns), why


def _progress(before: Progress, camera: CameraSigns, slots: int, now_ns: int) -> Progress:
    signs = before.signs
    if not camera.fresh or camera.session != signs.session:
        return Progress(camera, now_ns, slots, now_ns)
    if camera.orders > signs.orders:
        signs = replace(signs, orders=camera.orders)
        before = replace(before, orders_ns=now_ns, slots=slots)
    if camera.views > signs.views:
        signs = replace(signs, views=camera.views, due=camera.due)
        before = replace(before, views_ns=now_ns)
    if now_ns - before.views_ns < SETTLED_S * 1e9:
        signs = replace(signs, sent=camera.sent)
    return replace(before, signs=replace(signs, fresh=True))


def _stall(
    progress: Sequence[Progress],
    cameras: Sequence[CameraSigns],
    slots: int,
    sending_ns: int | None,
    now_ns: int,
) -> str:
    """Return why the edge is useless; a minority of cameras is no reason."""
    if sending_ns is not None and now_ns - sending_ns >= STALL_S * 1e9:
        return "a message could not be sent"
    fresh = [(one, camera) for one, camera in zip(progress, cameras, strict=True) if camera.fresh]
    if sum(_unreached(one, slots, now_ns) for one, _ in fresh) > len(fresh) / 2:
        return "orders do not reach the cameras, whose heartbeats arrive"
    if sum(_unheard(one, camera, now_ns) for one, camera in fresh) > len(fresh) / 2:
        return "views do not arrive from cameras that send them"
    heard_ns = max((c.heard_ns for c in cameras if c.heard_ns is not None), default=None)
    silent = heard_ns is not None and now_ns - heard_ns >= STALL_S * 1e9
    if silent and any(camera.present for camera in cameras):
        return "nothing arrives from cameras that are connected"
    return ""


def _unreached(one: Progress, slots: int, now_ns: int) -> bool:
    """Return whether a camera that counts orders receives none."""
    stalled = now_ns - one.orders_ns >= STALL_S * 1e9
    return stalled and one.signs.orders > 0 and slots - one.slots >= LEAST_ORDERS


def _unheard(one: Progress, camera: CameraSigns, now_ns: int) -> bool:
    """Return whether the views that a camera sends do not arrive."""
    stalled = now_ns - one.views_ns >= STALL_S * 1e9
    due, sent = camera.due - one.signs.due, camera.sent - one.signs.sent
    return stalled and due >= LEAST_ORDERS and sent >= LEAST_SENT


class Watchdog:
    """Looks at the cameras of an edge; for one thread.

    Attributes:
        prepare: returns what opens the network again; None lets the edge be.
        folder: where stacks are dumped; None for nowhere.
    """

    def __init__(
        self, membership: Membership, clock: Clock, report: Callable[[str, str], None]
    ) -> None:
        """Start without observations.

        Args:
            membership: of the edge.
            clock: the edge's.
            report: called with the kind and message of an event.
        """
        self.prepare: Callable[[], Callable[[], Transport]] | None = None
        self.folder: Path | None = None
        self._membership, self._clock, self._report = membership, clock, report
        self._watch = StallWatch()

    def look(
        self,
        cameras: Sequence[CameraState],
        views: NDArray[np.int64],
        due: NDArray[np.int64],
        slots: int,
    ) -> bool:
        """Look at the cameras, and rejoin if that is needed; return whether it was done.

        Args:
            cameras: `(num_cameras,)` their states.
            views: `(num_cameras,)` views that arrived, in time or late.
            due: `(num_cameras,)` views that were ordered in time, and are due.
            slots: for which orders were given so far.

        Raises:
            RuntimeError: when the network cannot be left or joined: the program must be restarted.
        """
        now_ns, sending_ns = self._clock.now_ns(), self._membership.sending_ns
        signs = []
        for camera, arrived, ordered in zip(cameras, views.tolist(), due.tolist(), strict=True):
            beat, heard_ns = camera.beat, camera.heard_ns
            if beat is None or heard_ns is None:
                signs.append(CameraSigns(camera.present, heard_ns))
                continue
            fresh = camera.present and not beat.ends and now_ns - heard_ns <= SILENT_S * 1e9
            counted, speaks = (beat.session, beat.orders, beat.sent), beat.mode not in RESTING
            present, fresh = camera.present and speaks, fresh and speaks
            signs.append(CameraSigns(present, heard_ns, fresh, *counted, arrived, ordered))
        self._watch, why = watch_for_stall(self._watch, signs, slots, sending_ns, now_ns)
        if not why or self.prepare is None:
            return False
        self._report("stalled", f"{why}: rejoining the network; {self._dumped()}")
        try:
            self._membership.rejoin(self.prepare())
        except InputError as error:
            raise RuntimeError(f"cannot rejoin the network: {error}") from error
        self._report("rejoined", "the network was joined again")
        return True

    def _dumped(self) -> str:
        if self.folder is None:
            return "stacks of threads are not kept"
        try:
            return f"stacks of all threads are in {dump_stacks(self.folder, 'edge')}"
        except OSError as error:
            return f"stacks of threads cannot be written to {self.folder} ({reason_of(error)})"


def dump_stacks(folder: Path, program: str) -> Path:
    """Write the stacks of all threads to a file of a folder; return the file.

    Args:
        folder: where the program's logs are; made if it does not exist.
        program: begins the file's name.

    Raises:
        OSError: when the file cannot be written.
    """
    make_folder(folder)
    places = [folder / f"{program}-stacks-{number}.txt" for number in range(1, MAX_FILES + 1)]
    path = min(places, key=lambda place: place.stat().st_mtime_ns if place.exists() else 0)
    path.unlink(missing_ok=True)
    handle = open_new(path, file_mode(folder))
    try:
        faulthandler.dump_traceback(handle, all_threads=True)
        os.ftruncate(handle, min(os.fstat(handle).st_size, MAX_BYTES))
    finally:
        os.close(handle)
    return path


KEEPING_S = 1.0  # status, checkpoint
MOST_CHANGES, CHANGES_S = 10, 60.0  # of one camera that are reported in so much time
LOOK_S = 0.2  # interval of checks for connected cameras; each costs what a tenth of a slot does


class Housekeeping:
    """Looks after an edge on a thread of its own.

    Attributes:
        watchdog: makes a stuck edge join its network again.
        quiet: set when a slot was just computed.
        rejoined: set when the network was joined again, to be cleared by the fusion thread.
    """

    def __init__(self, edge: RunningEdge) -> None:
        """Look after an edge that has all its parts but this one."""
        self.watchdog = Watchdog(edge.membership, edge.clock, edge.event_log.report)
        self.quiet, self.rejoined = threading.Event(), threading.Event()
        self._edge, self._due_ns = edge, 0
        num_cameras = len(edge.pipeline.rig)
        nothing = [""] * num_cameras
        self._conditions: Conditions = ["never connected"] * num_cameras, nothing, nothing
        self._changes: dict[str, deque[int]] = {}  # by camera, when they were reported

    def run(self) -> None:
        """Look until the edge stops."""
        clock, stopping = self._edge.clock, self._edge.threads.stopping
        while not stopping.is_set():
            self.look()
            clock.wait(stopping, clock.now_ns() + round(LOOK_S * 1e9))
            # Two threads of Python work at half the speed: not while a slot is computed.
            self.quiet.clear()
            self.quiet.wait(LOOK_S)

    def look(self) -> None:
        """Run the tasks that are due."""
        edge = self._edge
        counts = edge.gather.views, edge.counts.ordered, edge.counts.slots
        if edge.ready and self.watchdog.look(edge.inbox.cameras, *counts):
            self.rejoined.set()
            edge.start_sending()  # the thread before may hang
        # No camera recovers because the edge became too slow to judge it.
        slow = edge.load.overloaded()
        judged = self._conditions[1:] if slow else edge.impairments()
        before, found = self._conditions, edge.inbox.standings()
        problems = [lasting_problem(*one, was) for one, was in zip(found, before[0], strict=True)]
        self._conditions = problems, *judged
        events = camera_changes(edge.pipeline.rig.titles, before, self._conditions)
        for event in events:
            self._report(*event)
        if events or edge.clock.now_ns() >= self._due_ns:
            self._due_ns = edge.clock.now_ns() + round(KEEPING_S * 1e9)
            edge.send_queue.put(
                topics.of_site(edge.settings.site, "status"), encode(site_status(edge))
            )
            self.keep_checkpoint()

    def _report(self, kind: str, message: str, camera_id: str) -> None:
        """Report a change of a camera, unless it changes all the time and hides the others'."""
        now_ns = self._edge.clock.now_ns()
        times = self._changes.setdefault(camera_id, deque())
        while times and now_ns - times[0] > CHANGES_S * 1e9:
            times.popleft()
        if len(times) > MOST_CHANGES:
            return
        times.append(now_ns)
        if len(times) > MOST_CHANGES:
            title = self._edge.pipeline.rig.titles[camera_id]
            kind, message = "camera-unsteady", f"{title} changes too often: not reported"
        self._edge.event_log.report(kind, message, camera_id)

    def keep_checkpoint(self) -> None:
        """Save the state of the loop."""
        edge = self._edge
        times, state = edge.times, edge.state  # values: they stay
        if times is None or not edge.ready:
            return
        made_ns, run_ns = edge.clock.now_ns(), edge.state_file.run_ns
        made = Checkpoint(state, times.origin_ns, len(state.selections), made_ns, run_ns)
        edge.state_file.keep(made)


def lasting_problem(state: State, why: str, was: str) -> str:
    """Return a camera's problem; sleeping by order is none, connecting still is."""
    if state == State.ASLEEP:
        return ""
    return was if why == CONNECTING else why
