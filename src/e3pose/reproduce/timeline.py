"""Frame rate against network and server delay, for the designs of the paper's timeline figure.

Ours is the real thing: an edge and cameras in one process, whose messages are delayed. The others
are emulated: with central control by 2D boxes every frame waits for a round trip and the server's
decision; with distributed control cameras decide alone. Detection takes a fixed
time in all of them, and so do the 2D motion vectors that both others need.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from e3pose.camera.live import CameraNode, NodeSettings
from e3pose.camera.live_source import RecordedSource
from e3pose.clock import WallClock
from e3pose.edge.server import EdgeServer
from e3pose.model.pose import Poses2D
from e3pose.predict.base import Floats, Prediction, Predictor
from e3pose.recording import Recording
from e3pose.reproduce.sources import Sources
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate import SceneSettings, simulate
from e3pose.wire.memory import Hub, MemoryTransport

FPS = 25.0
SCENE = SceneSettings("ring", people=2, seconds=4.0, fps=FPS, cameras=3)
DETECT_S, VECTORS_S = 0.020, 0.002
EVERY_CAMERA = ReplaySettings(pipeline="paper", policy="all", predictor="zero-velocity")


class Delays:
    """Calls things later, in order."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._change, self._count, self._closed = threading.Condition(), 0, False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def call(self, after_s: float, what: Callable[[], None]) -> None:
        """Call something after a time."""
        with self._change:
            self._count += 1
            heapq.heappush(self._due, (time.monotonic() + after_s, self._count, what))
            self._change.notify()

    def close(self) -> None:
        """Call nothing any more."""
        with self._change:
            self._closed = True
            self._change.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._change:
                now = time.monotonic()
                if self._closed:
                    return
                if not self._due or self._due[0][0] > now:
                    self._change.wait(self._due[0][0] - now if self._due else None)
                    continue
                _, _, what = heapq.heappop(self._due)
            what()


class SlowTransport(MemoryTransport):
    """A transport whose messages take half a round trip."""

    delays: Delays
    half_s: float = 0.0

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message, which arrives later."""
        send = super().publish
        self.delays.call(self.half_s, lambda: send(topic, payload))

    def ask(self, topic: str, payload: bytes, timeout_s: float) -> bytes | None:
        """Ask, and wait for question and answer to arrive."""
        time.sleep(self.half_s)
        answer = super().ask(topic, payload, timeout_s)
        time.sleep(self.half_s)
        return answer


class SlowDetector:
    """Takes its time, and returns what the recording says."""

    def detect(self, image: Poses2D) -> Poses2D:
        """See `Detector.detect`."""
        time.sleep(DETECT_S)
        return image


@dataclass(frozen=True)
class SlowPredictor:
    """Stands for a server that takes its time."""

    predictor: Predictor
    server_s: float

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        time.sleep(self.server_s)
        return self.predictor.predict(history_m, interval_s, lead_slots)


def ours(
    recording: Recording,
    round_trip_s: float,
    server_s: float,
    seconds: float,
    settings: ReplaySettings = EVERY_CAMERA,
) -> float:
    """Return the slots in a second of which the views of all selected cameras came in time.

    Args:
        recording: what the cameras play.
        round_trip_s: delay of the network, there and back.
        server_s: time that a prediction takes beyond its own.
        seconds: how long to count, once the lead has settled.
        settings: of the loop; by default all cameras are selected in every slot.
    """
    hub, delays, clock = Hub(), Delays(), WallClock()

    def join() -> SlowTransport:
        made = SlowTransport(hub)
        made.delays, made.half_s = delays, round_trip_s / 2
        hub.members.append(made)
        return made

    pipeline = make_pipeline(recording, settings)
    pipeline = replace(pipeline, predictor=SlowPredictor(pipeline.predictor, server_s))
    edge = EdgeServer(
        pipeline,
        join(),
        EdgeSettings(
            "lab",
            recording.skeleton.joints,
            deadline_s=2 * round_trip_s + 0.3,
            idle_modes=["power-saving"] * len(recording.rig),
        ),
        clock,
    )
    nodes = [
        CameraNode(
            NodeSettings("lab", camera_id, recording.skeleton.joints),
            RecordedSource(recording, camera_id, clock),
            SlowDetector(),
            join(),
            clock,
        )
        for camera_id in recording.rig.camera_ids
    ]
    for node in nodes:
        node.start()
    edge.start()
    while edge.counts.slots < 2 * FPS:  # until the lead has settled
        time.sleep(0.05)
    begun, views = time.monotonic(), edge.counts.views
    time.sleep(seconds)
    rate = (edge.counts.views - views) / (time.monotonic() - begun)
    rate /= len(nodes) if settings.policy == "all" else _selected(settings, len(nodes))
    for node in nodes:
        node.stop()
    edge.stop()
    delays.close()
    return rate


def _selected(settings: ReplaySettings, num_cameras: int) -> float:
    return float(settings.for_rig(num_cameras).num_selected or num_cameras)


def central_2d(round_trip_s: float, server_s: float, seconds: float) -> float:
    """Return the frames a second of cameras that wait for the decision of every frame."""
    delays, frames = Delays(), 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        begun, decided = time.monotonic(), threading.Event()
        time.sleep(VECTORS_S)
        delays.call(round_trip_s + server_s, decided.set)
        decided.wait()
        time.sleep(DETECT_S)
        frames += 1
        time.sleep(max(0.0, 1 / FPS - (time.monotonic() - begun)))
    delays.close()
    return frames / seconds


def distributed(seconds: float) -> float:
    """Return the frames a second of cameras that decide alone."""
    frames, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        begun = time.monotonic()
        time.sleep(VECTORS_S + DETECT_S)
        frames += 1
        time.sleep(max(0.0, 1 / FPS - (time.monotonic() - begun)))
    return frames / seconds


@dataclass(frozen=True, slots=True)
class RatesAsked:
    """Delays of the network and the server in milliseconds, and seconds to count for."""

    round_trip_ms: float
    server_ms: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Rates:
    """Frames a second of the three designs."""

    ours: float
    central: float
    distributed: float


def rates(sources: Sources, asked: RatesAsked) -> Rates:
    """Measure the three designs; ours has the paper's policy and the shipped predictor."""
    recording = simulate(SCENE, 1)
    trip_s, server_s = asked.round_trip_ms / 1e3, asked.server_ms / 1e3
    settings = ReplaySettings(pipeline="paper", policy="e3pose", num_selected=2)
    return Rates(
        ours(recording, trip_s, server_s, asked.seconds, settings),
        central_2d(trip_s, server_s, asked.seconds),
        distributed(asked.seconds),
    )
