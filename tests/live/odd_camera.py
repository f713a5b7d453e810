"""A camera of a site that behaves badly: `odd_camera.py HABIT CAMERA ENDPOINT KEYS RECORDING`."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event

from e3pose.base.clock import WallClock
from e3pose.camera.base import LiveFrame, NodeSettings
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import RecordedSource
from e3pose.recording import load_recording
from e3pose.site.run import run_until_stopped
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in
from e3pose.wire.network import NetworkTransport, open_network

STEP_AFTER_S, STEP_S, OFF_S = 4.0, 30.0, -3600.0
DRIFT = 300e-6  # a bad quartz


@dataclass
class OddClock:
    """An hour behind, too fast, and set by half a minute after some seconds."""

    wall: WallClock = field(default_factory=WallClock)
    begun_ns: int = field(default_factory=time.monotonic_ns)

    def now_ns(self) -> int:
        gone_ns = time.monotonic_ns() - self.begun_ns
        step_s = STEP_S if gone_ns > STEP_AFTER_S * 1e9 else 0.0
        return self.wall.now_ns() + round((OFF_S + step_s) * 1e9 + gone_ns * DRIFT)

    def wait(self, event: Event, until_ns: int) -> bool:
        return event.wait(max(0.0, (until_ns - self.now_ns()) / 1e9))


def flood(transport: NetworkTransport, camera_id: str) -> None:
    """Say far too much, most of it nonsense, some of it large, until SIGTERM."""
    over = Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    transport.be_present(f"e3pose/lab/camera/{camera_id}/alive")
    messages = (b"garbage", b"\x92\x01\x91\xa4view", b"x" * 200_000, b"")
    while not over.wait(0.001):  # or the session may not get to learn that anybody subscribes
        for message in messages:
            for what in ("view", "heartbeat", "hello"):
                transport.publish(f"e3pose/lab/camera/{camera_id}/{what}", message)


def main() -> None:
    habit, camera_id, endpoint, keys, path = sys.argv[1:]
    link = Link("camera", "lab", read_endpoint(endpoint), certificates_in(Path(keys), "camera"))
    transport = open_network(link)
    if habit == "flood":
        flood(transport, camera_id)
        transport.close()
        return
    recording = load_recording(Path(path))
    # People go on as they do for everybody else; only what the camera takes for the time is odd.
    source = RecordedSource(recording, camera_id, WallClock())
    clock = OddClock()
    node = CameraNode(
        NodeSettings("lab", camera_id, recording.skeleton.joints),
        _Stamped(source, clock),
        None,
        transport,
        clock,
    )
    with node:
        run_until_stopped(node.running)
    if node.threads.failure is not None:
        raise node.threads.failure


@dataclass
class _Stamped:
    """A source whose frames have the times of another clock."""

    source: RecordedSource
    clock: OddClock

    @property
    def fps(self) -> float:
        return self.source.fps

    def open(self) -> None:
        self.source.open()

    def read(self) -> LiveFrame | None:
        frame = self.source.read()
        if frame is None:
            return None
        late_ns = self.source.clock.now_ns() - frame.captured_ns
        return replace(frame, captured_ns=self.clock.now_ns() - late_ns)

    def close(self) -> None:
        self.source.close()


if __name__ == "__main__":
    main()
