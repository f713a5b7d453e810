"""Every source, and one's own, keeps to its Protocol: opened again, in time, in images or poses."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path

import av
import cv2
import httpx
import numpy as np
import pytest
from tests.camera import stand_ins
from tests.camera.mjpeg import jpeg, network_camera
from tests.memory_transport import Hub
from tests.ports import free_port

from e3pose.base.clock import SlotTimes, WallClock
from e3pose.base.errors import InputError
from e3pose.camera.base import DetectingSource, LiveFrame, LiveSource, SteeredSource
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import GROUP, SOURCES, STREAMS, make_source
from e3pose.camera.phone_file import PhoneFile, save_phone
from e3pose.camera.picamera import SensorSource
from e3pose.camera.schedule import Schedule
from e3pose.camera.webcam import WebcamSource
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import save_recording
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.sources import located, scheme_of
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.camera_program import make_camera, open_camera
from e3pose.site.phones import show_phone
from e3pose.wire.arrays import poses_2d

OWN = """
import time
import numpy as np
from e3pose.camera.base import LiveFrame
class Grey:
    fps = 20.0
    def open(self): pass
    def read(self):
        time.sleep(0.05)
        return LiveFrame(time.time_ns(), (8, 6), lambda: np.zeros((6, 8, 3), np.uint8))
    def close(self): pass
"""
MORE = """
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
"""
SENT = Callable[[], object]  # makes a source have a frame, where it does not film by itself


@contextmanager
def file(folder: Path) -> Iterator[tuple[str, SENT]]:
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((6, 8, 3), 80 * number, np.uint8))
    yield str(folder), str


@contextmanager
def recorded(folder: Path) -> Iterator[tuple[str, SENT]]:
    save_recording(simulate(SceneSettings(people=1, seconds=1.0, cameras=2), 0), folder / "walk")
    yield f"recorded:{folder / 'walk'}", str


@contextmanager
def stream(folder: Path) -> Iterator[tuple[str, SENT]]:
    with network_camera(20.0) as url:
        yield url, str


@contextmanager
def phone(folder: Path) -> Iterator[tuple[str, SENT]]:
    path = folder / "anna.toml"
    save_phone(path, PhoneFile(free_port()))
    url, _, code = show_phone(path, None, "127.0.0.1").url.partition("/#")
    secret = dict[str, str]()

    def send() -> None:
        with httpx.Client(base_url=url, verify=False) as client:
            if not secret:
                answer = client.post("/join", content=code).json()
                secret["Authorization"] = f"Bearer {answer['secret']}"
            client.post("/frame", content=jpeg(90), headers=secret)

    yield f"phone:{path}", send


@contextmanager
def own(folder: Path) -> Iterator[tuple[str, SENT]]:
    (folder / "mine.py").write_text(OWN)
    yield located("mine.py:Grey", lambda name: folder / name), str


def webcam(folder: Path, monkeypatch: pytest.MonkeyPatch) -> LiveSource:
    machine = stand_ins.Webcams(folder)
    monkeypatch.setattr(av, "open", machine.open)
    machine.plug(0, "Front", "usb-Front-video-index0", "1-1")
    return WebcamSource("by-id/usb-Front-video-index0", WallClock(), 30.0, (64, 48), machine.dev)


def board(scheme: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> LiveSource:
    pi = stand_ins.raspberry_pi(monkeypatch)
    pi.outputs = [np.zeros((30, 17))] * 3
    stand_ins.oak(monkeypatch)
    stand_ins.gstreamer(monkeypatch)
    made = make_source(scheme, "cam1", WallClock())
    if isinstance(made, SensorSource):
        made.model = folder
    return made


# What stands in for each; a scheme without one fails the test below.
STAND_INS = {
    "file": file,
    "recorded": recorded,
    **dict.fromkeys(STREAMS, stream),
    "phone": phone,
}
DEVICES: dict[str, Callable[[Path, pytest.MonkeyPatch], LiveSource]] = {
    "usb": webcam,
    "gstreamer": partial(board, "gstreamer:videotestsrc"),
    "picamera2": partial(board, "picamera2:0"),
    "imx500": partial(board, "imx500:0"),
    "depthai": partial(board, "depthai:"),
    "depthai, detecting": partial(board, "depthai:?model=pose"),
}


def frames_of(source: LiveSource, send: SENT, count: int) -> list[LiveFrame]:
    """Return frames of an open source; no read may wait for much more than a second."""
    found, end_s = list[LiveFrame](), time.monotonic() + 20
    while len(found) < count and time.monotonic() < end_s:
        send()
        begun_s = time.monotonic()
        frame = source.read()
        assert time.monotonic() - begun_s < 3, "read waits at most a second"
        found += [] if frame is None else [frame]
    return found


def check(source: LiveSource, send: SENT) -> None:
    source.close()  # before it was opened
    for _ in range(2):
        source.open()
        frames = frames_of(source, send, 3)
        source.close()
        source.close()
        assert len(frames) == 3 and 0 < source.fps < 1000
        times_ns = [frame.captured_ns for frame in frames]
        assert times_ns == sorted(times_ns)
        assert all(abs(time.time_ns() - at) < 25e9 for at in times_ns)
        for frame in frames:
            image = frame.image()
            if isinstance(image, np.ndarray):
                width, height = frame.image_size
                assert image.shape == (height, width, 3) and image.dtype == np.uint8
            if isinstance(source, DetectingSource):
                assert frame.poses is not None
                assert frame.poses().scores.shape[1] == len(source.skeleton)
                assert source.detector
            else:
                assert frame.poses is None and isinstance(image, np.ndarray)


@pytest.mark.parametrize("scheme", [*STAND_INS, "module:Name"])
def test_a_source_keeps_to_its_protocol(scheme: str, tmp_path: Path) -> None:
    with STAND_INS.get(scheme, own)(tmp_path) as (name, send):
        check(make_source(name, "cam1", WallClock(), 20.0), send)


@pytest.mark.parametrize("device", DEVICES)
def test_a_device_keeps_to_its_protocol(
    device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check(DEVICES[device](tmp_path, monkeypatch), str)


def test_every_source_has_a_stand_in() -> None:
    assert {*SOURCES} == {*STAND_INS, *(name.partition(",")[0] for name in DEVICES)}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("webcam:0", "found 'webcam', expected one of usb, rtsp"),
        ("udp://@:5000", "found 'udp', expected one of usb, rtsp"),
        ("nomodule:Grey", "No module named 'nomodule', expected one of usb, rtsp"),
        ("mine.py:Grey", "there is no file mine.py, expected one of usb, rtsp"),
    ],
)
def test_an_unknown_scheme_is_refused_with_the_list(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        make_source(name, "cam1", WallClock())


def test_a_package_offers_a_scheme(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("toy", "tests.camera.test_source_contract:Sensor", GROUP)
    monkeypatch.setattr("e3pose.base.plugins.entry_points", lambda group: [point])
    assert isinstance(make_source("toy:3", "cam1", WallClock()), Sensor)
    with pytest.raises(InputError, match="file, toy"):
        make_source("tay:3", "cam1", WallClock())


def test_a_file_may_be_called_like_a_scheme() -> None:
    assert scheme_of("./take:1.mp4") == scheme_of("C:/walk.mp4") == ""
    assert scheme_of("/films/mine.py:Grey") == "" and scheme_of("usb:0") == "usb"


class Sensor:
    """A device that detects, in the whole image or where people are expected."""

    fps, skeleton, detector = 20.0, COCO17, "imx500"

    def __init__(self) -> None:
        self.expected: list[object] = []

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read(self) -> LiveFrame:
        time.sleep(0.02)
        return self.frame(time.time_ns())

    def frame(self, at_ns: int) -> LiveFrame:
        image = np.zeros((48, 64, 3), np.uint8)
        one = Poses2D(np.full((1, 17, 2), 20.0), np.full((1, 17), 0.5))
        return LiveFrame(at_ns, (64, 48), lambda: image, poses=lambda: one)

    def expect(self, expected: object) -> None:
        self.expected.append(expected)


SMALL = """
import json, sys, time
from e3pose.site.camera_program import open_camera
from e3pose.settings.camera_file import load_node
from e3pose.camera import live

asked = {"site": "lab", "camera": "c1", "source": sys.argv[1] + ":Sensor"}
with open_camera(load_node(None, {**asked, "endpoint": "tcp/127.0.0.1:9", "pictures": True})) as it:
    while it.node.counts.captured < 5:
        time.sleep(0.05)
    it.node._look(live._Seen(it.node.source.read(), 1, 0, 0, 10**8))
    heavy = {"cv2", "onnxruntime", "scipy", "av"} & {*sys.modules}
    said = open("/proc/self/status").read().partition("VmHWM:")[2].split()[0]
    print(json.dumps([it.node.counts.detected, sorted(heavy), int(said) / 1000]))
"""


def test_a_camera_whose_sensor_detects_is_small(tmp_path: Path) -> None:
    own = inspect.getsource(Sensor)
    (tmp_path / "mine.py").write_text(OWN.partition("class")[0] + MORE + own)
    command = [sys.executable, "-c", SMALL, str(tmp_path / "mine.py")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    looks, heavy, most_mb = json.loads(run.stdout.splitlines()[-1])
    assert looks == 1 and heavy == []
    assert most_mb <= 120, "of the 512 MB of a Raspberry Pi Zero 2 W"


def test_a_system_of_32_bits_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "maxsize", 2**31 - 1)
    with pytest.raises(InputError, match=r"one of 32 bits, expected one of 64 bits: NumPy"):
        open_camera("camera.toml")


def test_a_sensor_that_detects_needs_no_network_and_feedback_steers_it() -> None:
    sensor, clock = Sensor(), WallClock()
    assert isinstance(sensor, SteeredSource)
    table = NodeTable(format="e3pose-camera", version=1, site="lab", camera="cam1", source="own")
    node: CameraNode = make_camera(table, Hub().join(), clock, print, lambda _: {}, source=sensor)
    assert node.settings.detector == "imx500" and node.settings.joints == COCO17.joints
    assert node.detector is None
    times = SlotTimes(clock.now_ns() - 10**8, 10**8)
    near, far = (ExpectedView(np.full((1, 17, 2), px), np.ones(1)) for px in (9.0, 30.0))
    active = {slot: slot != 3 for slot in (1, 2, 3, 4)}
    node.schedule = Schedule(1, times, active=active, expected={2: near, 4: far})
    for slot in (1, 2, 3):
        node._take(sensor.frame(times.middle_ns(slot)))
    assert sensor.expected == [near, far, far]  # for the active slots after these
    seen = node._frames.take()
    assert seen is not None
    node._look(seen)
    view = node._views.take()
    assert view is not None and view.slot == 2 and len(poses_2d(view)) == 1
    assert node.counts.detected == 1
    node.source.close()
