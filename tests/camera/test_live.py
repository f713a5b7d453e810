"""A source that fails for hours is told of once when it fails, and once when it is back."""

from __future__ import annotations

import threading
import time

from e3pose.camera.base import LiveFrame
from e3pose.camera.live import CameraNode, NodeSettings
from e3pose.camera.live_source import RecordedDetector
from e3pose.clock import WallClock
from e3pose.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.wire.memory import Hub


class Unplugged:
    """A device that is not there until somebody plugs it in."""

    fps = 50.0

    def __init__(self) -> None:
        self.plugged = threading.Event()
        self.tries = 0

    def open(self) -> None:
        self.tries += 1
        if not self.plugged.is_set():
            raise InputError("source usb:0: found no /dev/video0")

    def read(self) -> LiveFrame | None:
        time.sleep(0.02)
        return LiveFrame(time.time_ns(), (640, 480), lambda: Poses2D.empty(17))

    def close(self) -> None:
        pass


def test_failing_source_is_told_once_and_its_return_once() -> None:
    told: list[str] = []
    source = Unplugged()
    node = CameraNode(
        NodeSettings("lab", "cam0", tuple(map(str, range(17)))),
        source,
        RecordedDetector(),
        Hub().join(),
        WallClock(),
        tell=told.append,
    )
    with node:
        end_s = time.monotonic() + 10
        while source.tries < 3 and time.monotonic() < end_s:
            time.sleep(0.02)
        assert told == ["source usb:0: found no /dev/video0"] == [node.problem]
        source.plugged.set()
        while node.counts.captured < 3 and time.monotonic() < end_s:
            time.sleep(0.02)
    assert told[1:] == ["frames from the source again"] and node.problem == ""
