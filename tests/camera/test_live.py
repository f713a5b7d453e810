"""A source that fails for hours is reported once when it fails, and once when it is back."""

from __future__ import annotations

import threading
import time

import pytest
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.base.clock import SlotTimes, WallClock
from e3pose.base.errors import InputError
from e3pose.camera.base import LiveFrame
from e3pose.camera.live import CameraNode, NodeSettings
from e3pose.camera.live_source import RecordedDetector
from e3pose.camera.schedule import Schedule
from e3pose.model.pose import Poses2D


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


def test_failing_source_is_reported_once_and_its_return_once() -> None:
    messages: list[str] = []
    source = Unplugged()
    node = CameraNode(
        NodeSettings("lab", "cam0", tuple(map(str, range(17)))),
        source,
        RecordedDetector(),
        Hub().join(),
        WallClock(),
        report=messages.append,
    )
    with node:
        end_s = time.monotonic() + 10
        while source.tries < 3 and time.monotonic() < end_s:
            time.sleep(0.02)
        assert messages == ["source usb:0: found no /dev/video0"] == [node.problem]
        source.plugged.set()
        while node.counts.captured < 3 and time.monotonic() < end_s:
            time.sleep(0.02)
    assert messages[1:] == ["frames from the source again"] and node.problem == ""


@pytest.mark.parametrize(("delay_ms", "slot"), [(0, 7), (200, 5)])
def test_what_a_frame_is_late_by_is_taken_off_its_time(delay_ms: int, slot: int) -> None:
    joints = tuple(map(str, range(17)))
    settings = NodeSettings("lab", "cam0", joints, delay_ns=delay_ms * 10**6)
    node = CameraNode(settings, Unplugged(), RecordedDetector(), Hub().join(), WallClock())
    times = SlotTimes(0, 10**8)
    node.schedule = Schedule(session=1, times=times, active={slot: True})
    node._take(LiveFrame(times.middle_ns(7), (640, 480), lambda: Poses2D.empty(17)))
    seen = node._frames.take()
    assert seen is not None and seen.slot == slot


def test_what_was_spent_is_taken_before_the_frame_of_an_active_slot_is_passed_on() -> None:
    def meter(mode: object) -> dict[str, float]:
        return {"energy_j": float(node._frames._thing is not None)}

    settings, times = NodeSettings("lab", "cam0", tuple(map(str, range(17)))), SlotTimes(0, 10**8)
    node = CameraNode(
        settings, Unplugged(), RecordedDetector(), Hub().join(), WallClock(), meter=meter
    )
    node.schedule = Schedule(session=1, times=times, active={7: True})
    node._spending.told.clear()  # as a heartbeat that waits for a slot does
    node._take(LiveFrame(times.middle_ns(7), (640, 480), lambda: Poses2D.empty(17)))
    assert node._frames._thing is not None
    spent = node._spending._taken.pop()
    assert (spent["energy_j"], spent["mode"], spent["active_s"]) == (0.0, "active", 0.0)


def test_first_frame_that_comes_during_a_heartbeat_delays_no_hello() -> None:
    hub, source, said = Hub(), Unplugged(), list[str]()
    hub.join().subscribe("e3pose/lab/camera/cam0/*", lambda topic, _: said.append(topic))

    def asked(topic: str, payload: bytes) -> bytes:
        if topic.endswith("/clock"):  # which is a part of a heartbeat
            source.plugged.set()
            said.append(topic)
            assert eventually(lambda: node.counts.captured > 0)
        return payload

    hub.fault = asked
    joints = tuple(map(str, range(17)))
    settings = NodeSettings("lab", "cam0", joints)
    node = CameraNode(settings, source, RecordedDetector(), hub.join(), WallClock())
    with node:
        assert eventually(lambda: "e3pose/lab/camera/cam0/hello" in said)
    assert (
        said.index("e3pose/lab/camera/cam0/hello") == 1
    )  # of four heartbeats, it is in each first
