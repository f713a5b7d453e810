"""A site in one process: three cameras and an edge on their threads, and the air between them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.camera.live import CameraNode, NodeSettings
from e3pose.camera.live_source import RecordedSource
from e3pose.edge.consumers import NO_CONSUMERS, Consumers
from e3pose.edge.events import EventLog
from e3pose.edge.server import EdgeServer
from e3pose.edge.state_file import StateFile
from e3pose.recording import Recording
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.store.rows import Event
from e3pose.wire.codec import decode
from e3pose.wire.site_messages import CameraStatus, Poses

SPEED = 2  # of what sites do; of each slot 25 ms are left


@dataclass(frozen=True, slots=True)
class QuickClock:
    """A wall clock that is quicker than time, so that nobody waits as long as it says.

    Attributes:
        origin_ns: time of day minus the steady counter.
    """

    origin_ns: int = field(default_factory=lambda: time.time_ns() - SPEED * time.monotonic_ns())

    def now_ns(self) -> int:
        """See `Clock.now_ns`."""
        return self.origin_ns + SPEED * time.monotonic_ns()

    def wait(self, event: threading.Event, until_ns: int) -> bool:
        """See `Clock.wait`."""
        return event.wait(max(0.0, (until_ns - self.now_ns()) / SPEED / 1e9))


@dataclass
class Site:
    """Three cameras that look at a simulated room, and an edge."""

    recording: Recording
    folder: Path
    hub: Hub = field(default_factory=lambda: Hub(speed=SPEED))
    clock: QuickClock = field(default_factory=QuickClock)
    nodes: dict[str, CameraNode] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    poses: list[Poses] = field(default_factory=list)
    delayed: list[Poses] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    edge: EdgeServer = field(init=False)
    deadline_s: float = 0.15
    num_selected: int = 2
    smooth_delay_s: float = 0.0
    feedback: bool = False
    consume: Callable[[EventLog], Consumers] = lambda log: NO_CONSUMERS

    def start_edge(self) -> EdgeServer:
        edge = self.make_edge()
        edge.start()
        return edge

    def make_edge(self) -> EdgeServer:
        """Return the edge before it starts, with the state that the one before it left."""
        settings = ReplaySettings(
            pipeline="memory", policy="round-robin", num_selected=self.num_selected,
            predictor="zero-velocity", feedback=self.feedback,
        )  # fmt: skip
        edge_settings = EdgeSettings(
            "lab",
            self.recording.skeleton,
            deadline_s=self.deadline_s,
            idle_modes=["power-saving"] * len(self.recording.rig),
            start_wait_s=1.0,
            smooth_delay_s=self.smooth_delay_s,
        )
        event_log = EventLog(self.clock, self.events.append)
        pipeline = make_pipeline(self.recording, settings)
        self.edge = EdgeServer(
            pipeline,
            self.hub.join(),
            edge_settings,
            self.clock,
            StateFile(pipeline, self.folder / "state.npz", event_log.report, self.clock.now_ns()),
            event_log,
            self.consume(event_log),
        )
        return self.edge

    def start_camera(self, camera_id: str, **settings: Any) -> CameraNode:
        node = CameraNode(
            NodeSettings("lab", camera_id, self.recording.skeleton.joints, **settings),
            RecordedSource(self.recording, camera_id, self.clock),
            None,
            self.hub.join(),
            self.clock,
            report=lambda line: self.words.append(f"{camera_id}: {line}"),
        )
        node.start()
        self.nodes[camera_id] = node
        return node

    def online(self) -> set[str]:
        return {c.camera_id for c in self.edge.status().cameras if c.online}

    def camera(self, camera_id: str) -> CameraStatus:
        return next(c for c in self.edge.status().cameras if c.camera_id == camera_id)

    def was_lost(self, camera_id: str) -> bool:
        return any(e.kind == "camera-lost" and e.camera_id == camera_id for e in self.events)

    def reported(self, kind: str, camera_id: str) -> bool:
        """Return whether the newest word on a camera is of a kind."""
        words = [event.kind for event in self.events if event.camera_id == camera_id]
        return words[-1:] == [kind]


@cache
def scene() -> Recording:
    scene = SceneSettings("ring", people=2, seconds=4.0, fps=20, cameras=3)
    return simulate(scene, seed=4)


def started(folder: Path, **options: Any) -> Site:
    """Return a site of which nothing runs yet, and somebody who follows it."""
    made = Site(scene(), folder, **options)
    viewer = made.hub.join()
    viewer.subscribe("e3pose/lab/poses", lambda t, p: made.poses.append(decode(p, Poses, "edge")))
    viewer.subscribe(
        "e3pose/lab/poses-delayed", lambda t, p: made.delayed.append(decode(p, Poses, "edge"))
    )
    return made


@contextmanager
def site_at_work(folder: Path, **options: Any) -> Iterator[Site]:
    """Run a site of which some slots are done; see `Site` for its options."""
    made = started(folder, **options)
    edge = made.start_edge()  # first: cameras say who they are at once, and then each two seconds
    for camera_id in made.recording.rig.camera_ids:
        made.start_camera(camera_id)
    try:
        assert eventually(lambda: edge.counts.slots > 10)
        yield made
    finally:
        for node in made.nodes.values():
            node.stop()
        made.edge.stop()
