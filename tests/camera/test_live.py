"""A source that fails for hours is reported once when it fails, and once when it is back."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.camera.mjpeg import network_camera
from tests.edge.one_process import started
from tests.memory_transport import Hub
from tests.waiting import eventually, settled

from e3pose.base.clock import SlotTimes, WallClock
from e3pose.base.errors import InputError
from e3pose.camera import live
from e3pose.camera.base import LiveFrame
from e3pose.camera.live import CameraNode, NodeSettings, Repeats
from e3pose.camera.live_source import StreamSource
from e3pose.camera.schedule import Schedule
from e3pose.model.pose import Poses2D


def nobody(captured_ns: int) -> LiveFrame:
    """Return a frame of a source that detects, in which nobody is."""
    view = Poses2D.empty(17)
    return LiveFrame(captured_ns, (640, 480), lambda: view, poses=lambda: view)


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
        return nobody(time.time_ns())

    def close(self) -> None:
        pass


def test_failing_source_is_reported_once_and_its_return_once() -> None:
    messages: list[str] = []
    source = Unplugged()
    node = CameraNode(
        NodeSettings("lab", "cam0", tuple(map(str, range(17)))),
        source,
        None,
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


def problems(marks: Sequence[int | None], every_s: float) -> list[str]:
    repeats, found = Repeats(), list[str]()
    for number, mark in enumerate(marks):
        frame = LiveFrame(round(number * every_s * 1e9), (8, 8), lambda: None)
        if mark is not None:
            frame = replace(frame, mark=partial(int, mark))
        found.append(repeats.problem(frame))
    return found


def test_only_a_picture_that_never_changes_for_five_seconds_is_a_problem() -> None:
    still = problems([7] * 140 + [8, 9, 9], 0.04)
    assert still.index("the same picture for 5 s") in range(125, 140)
    assert still[-3:] == ["", "", ""], "it counts again from the first picture that differs"
    assert not any(problems(list(range(400)), 0.04)), "noise of a still room"
    assert not any(problems([None] * 400, 0.04)), "a film, or a codec that sends changes alone"
    assert not any(problems([n // 90 for n in range(900)], 0.04)), "a film at a ninetieth"
    assert not any(problems([1, 1, 2, 2, 3, 3], 60.0)), "a closed source begins with an old one"
    assert problems([1] * 12, 60.0)[-1].startswith("the same picture for")


def test_a_frozen_network_camera_counts_for_nothing_until_its_picture_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its keypoints are always where they were: nobody would seem to measure better."""
    monkeypatch.setattr(live, "SAME_NS", 1_000_000_000)
    monkeypatch.setattr(live, "SAME_EVERY_NS", 100_000_000)
    site = started(tmp_path, num_selected=3)
    camera = site.recording.rig.cameras[2]
    size = camera.image_size[::-1]
    alive = [
        cv2.imencode(".jpg", np.full((*size, 3), level, dtype=np.uint8))[1].tobytes()
        for level in (100, 140, 180)
    ]
    shown, seen = list(alive), site.recording.views[2].view(0) or Poses2D.empty(17)

    class Still:
        def detect(self, image: object) -> Poses2D:
            return seen

    def views() -> int:
        return node.counts.sent

    with network_camera(10.0, shown) as url:
        edge = site.start_edge()
        nodes = [site.start_camera(name) for name in site.recording.rig.camera_ids[:2]]
        node = CameraNode(
            NodeSettings("lab", camera.camera_id, site.recording.skeleton.joints),
            StreamSource(url, site.clock), Still(), site.hub.join(), site.clock,
        )  # fmt: skip
        node.start()
        try:
            assert eventually(lambda: len(site.online()) == 3 and views() > 5)
            del shown[1:]
            assert eventually(lambda: "the same picture" in site.camera(camera.camera_id).why)
            assert site.online() == set(site.recording.rig.camera_ids[:2])
            assert eventually(lambda: site.reported("camera-lost", camera.camera_id))
            assert "the same picture for " in site.events[-1].message
            assert settled(views) == views(), "no view of it comes any more"
            shown += alive[1:]
            before = views()
            assert eventually(lambda: len(site.online()) == 3 and views() > before)
        finally:
            for one in (*nodes, node):
                one.stop()
            edge.stop()


@pytest.mark.parametrize(("delay_ms", "slot"), [(0, 7), (200, 5)])
def test_what_a_frame_is_late_by_is_taken_off_its_time(delay_ms: int, slot: int) -> None:
    joints = tuple(map(str, range(17)))
    settings = NodeSettings("lab", "cam0", joints, delay_ns=delay_ms * 10**6)
    node = CameraNode(settings, Unplugged(), None, Hub().join(), WallClock())
    times = SlotTimes(0, 10**8)
    node.schedule = Schedule(session=1, times=times, active={slot: True})
    node._take(nobody(times.middle_ns(7)))
    seen = node._frames.take()
    assert seen is not None and seen.slot == slot


def test_what_was_spent_is_taken_before_the_frame_of_an_active_slot_is_passed_on() -> None:
    def meter(mode: object) -> dict[str, float]:
        return {"energy_j": float(node._frames._thing is not None)}

    settings, times = NodeSettings("lab", "cam0", tuple(map(str, range(17)))), SlotTimes(0, 10**8)
    node = CameraNode(settings, Unplugged(), None, Hub().join(), WallClock(), meter=meter)
    node.schedule = Schedule(session=1, times=times, active={7: True})
    node._spending.told.clear()  # as a heartbeat that waits for a slot does
    node._take(nobody(times.middle_ns(7)))
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
    node = CameraNode(settings, source, None, hub.join(), WallClock())
    with node:
        assert eventually(lambda: "e3pose/lab/camera/cam0/hello" in said)
    assert (
        said.index("e3pose/lab/camera/cam0/hello") == 1
    )  # of four heartbeats, it is in each first
