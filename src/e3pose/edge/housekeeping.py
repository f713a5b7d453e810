"""Periodic work of an edge: status, checkpoint, camera events, and the watchdog."""

from __future__ import annotations

import threading
from collections import deque

from e3pose.edge.camera_state import CONNECTING, State
from e3pose.edge.checkpoint import Checkpoint
from e3pose.edge.reports import Conditions, RunningEdge, camera_changes, site_status
from e3pose.edge.watchdog import Watchdog
from e3pose.wire import topics
from e3pose.wire.codec import encode

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
            kind, message = "camera-unsteady", f"{camera_id} changes too often: not reported"
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
