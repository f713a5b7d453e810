"""Stand-ins for devices, written from the documented interfaces of their libraries."""

from __future__ import annotations

import datetime
import errno
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest

SIZE = (64, 48)


# Video4Linux: the device is a film, read as FFmpeg reads a device that is not waited for.


def film(path: Path, codec: str = "mjpeg", count: int = 60) -> Path:
    """Write pictures of one grey each, coded one by one."""
    with REAL_OPEN(str(path), "w", format="avi") as container:
        stream: Any = container.add_stream(codec, rate=Fraction(30))
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuyv422"
        for number in range(count):
            image = np.full((SIZE[1], SIZE[0], 3), 40 + number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


@dataclass
class Webcams:
    """Devices of one machine: `/dev` and `/sys`, and what FFmpeg makes of opening one."""

    root: Path
    opened: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    refuses: dict[str, int] = field(default_factory=dict)  # by device, why it cannot be opened
    without_mjpg: bool = False
    unplugged_after: int = 10**9  # frames

    @property
    def dev(self) -> Path:
        return self.root / "dev"

    @property
    def sys(self) -> Path:
        return self.root / "sys"

    def plug(self, number: int, title: str, by_id: str, port: str, mbit: int = 480) -> None:
        """Plug a webcam into a port such as `1-2.3`; `by_id` is empty without a serial number."""
        node = self.dev / f"video{number}"
        node.parent.mkdir(parents=True, exist_ok=True)
        node.touch()
        for way, name in (("by-id", by_id), ("by-path", f"pci-usb-0:{port}:1.0-video-index0")):
            if name:
                link = self.dev / "v4l" / way / name
                link.parent.mkdir(parents=True, exist_ok=True)
                link.unlink(missing_ok=True)
                link.symlink_to(node)
        place = self.sys / "devices/pci0/usb1" / port.partition(".")[0] / port
        (place / f"{port}:1.0").mkdir(parents=True, exist_ok=True)
        (place / "speed").write_text(f"{mbit}\n")
        shown = self.sys / "class/video4linux" / f"video{number}"
        shown.mkdir(parents=True)
        (shown / "index").write_text("0\n")
        (shown / "name").write_text(f"{title}\n")
        (shown / "device").symlink_to(place / f"{port}:1.0")

    def open(self, place: str, **asked: Any) -> Any:
        """Open a device as `av.open` does."""
        self.opened.append((place, asked["options"]))
        if code := self.refuses.get(Path(place).name, 0):
            raise av.error.classes.get(code, av.error.OSError)(code, os.strerror(code), place)
        mjpg = "input_format" in asked["options"]
        if mjpg and self.without_mjpg:
            raise av.error.ArgumentError(errno.EINVAL, "Invalid argument", place)
        path = self.root / ("mjpg.avi" if mjpg else "raw.avi")
        if not path.exists():
            film(path, "mjpeg" if mjpg else "rawvideo")
        return _Device(REAL_OPEN(str(path)), self)


REAL_OPEN = av.open


class _Device:
    """A container whose packets are not always there, and end where it is unplugged."""

    def __init__(self, container: Any, webcams: Webcams) -> None:
        self.container, self.webcams, self.asked = container, webcams, 0
        self.packets: Iterator[Any] = container.demux(container.streams.video[0])
        self.streams = container.streams

    def demux(self, stream: Any) -> Iterator[Any]:
        self.asked += 1
        if self.asked // 2 >= self.webcams.unplugged_after:
            raise av.error.OSError(errno.ENODEV, "No such device", "video0")
        if self.asked % 2:
            raise av.error.BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable", "")
        packet = next(self.packets, None)
        if packet is not None:
            yield packet

    def close(self) -> None:
        self.container.close()


# GStreamer through PyGObject 3.42.


def gstreamer(monkeypatch: pytest.MonkeyPatch, fails: str = "") -> list[str]:
    """Stand in for PyGObject; return the pipelines that are made, of pictures of 21 x 4."""
    made: list[str] = []
    width, height, stride = 21, 4, 64
    caps = SimpleNamespace(
        get_value={"width": width, "height": height}.get, get_fraction=lambda _: (True, 30, 1)
    )
    rows = np.zeros((height, stride), np.uint8)
    rows[:, : 3 * width] = np.arange(3 * width)
    buffer = SimpleNamespace(
        map=lambda _: (True, SimpleNamespace(data=rows.tobytes())), unmap=lambda _: None
    )
    sample = SimpleNamespace(
        get_caps=lambda: SimpleNamespace(get_structure=lambda _: caps), get_buffer=lambda: buffer
    )
    problem = SimpleNamespace(type=1, parse_error=lambda: (SimpleNamespace(message=fails), "debug"))

    class Error(Exception):
        message = 'no element "nothing"'

    def pulled(*_: object) -> Any:
        time.sleep(0.01)
        return None if fails else sample

    def parse_launch(text: str) -> Any:
        if "nothing" in text:
            raise Error
        made.append(text)
        sink = SimpleNamespace(emit=pulled)
        bus = SimpleNamespace(pop_filtered=lambda _: problem if fails else None)
        return SimpleNamespace(
            get_by_name=lambda _: sink, set_state=lambda _: 1, get_bus=lambda: bus
        )

    gst = SimpleNamespace(
        init=lambda _: None, parse_launch=parse_launch,
        State=SimpleNamespace(PLAYING=4, NULL=1), StateChangeReturn=SimpleNamespace(FAILURE=0),
        MessageType=SimpleNamespace(ERROR=1, EOS=2), MapFlags=SimpleNamespace(READ=1),
    )  # fmt: skip
    repository = _module("gi.repository", Gst=gst, GLib=SimpleNamespace(Error=Error))
    _install(
        monkeypatch, _module("gi", require_version=lambda *_: None, repository=repository),
        repository,
    )  # fmt: skip
    return made


# picamera2 0.3.38.


@dataclass
class Board:
    """A Raspberry Pi: its cameras, what was asked of them, and what the AI Camera finds."""

    asked: list[dict[str, Any]] = field(default_factory=list)
    regions: list[tuple[int, ...]] = field(default_factory=list)
    held: int = 0  # frames that were not given back
    outputs: list[Any] = field(default_factory=list)
    busy: bool = False
    crop: tuple[int, int, int, int] = (0, 0, 4056, 3040)


def raspberry_pi(monkeypatch: pytest.MonkeyPatch, numbers: tuple[int, ...] = (0,)) -> Board:
    """Stand in for picamera2 and libcamera; return the board."""
    board = Board()

    class Request:
        def __init__(self, size: tuple[int, int]) -> None:
            board.held += 1
            self.size = size

        def get_metadata(self) -> dict[str, Any]:
            now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
            return {
                "SensorTimestamp": now_ns - 20_000_000, "FrameDuration": 90_909,
                "ScalerCrop": board.crop,
            }  # fmt: skip

        def make_array(self, name: str) -> Any:
            assert name == "main"
            return np.full((self.size[1], self.size[0], 3), 7, np.uint8)

        def release(self) -> None:
            board.held -= 1

    class Picamera2:
        def __init__(self, number: int) -> None:
            if board.busy:
                raise RuntimeError("Camera __init__ sequence did not complete.")

        @staticmethod
        def global_camera_info() -> list[dict[str, Any]]:
            return [{"Num": n, "Model": "imx500", "Id": f"/base/{n}"} for n in numbers]

        def create_video_configuration(self, **asked: Any) -> dict[str, Any]:
            board.asked.append(asked)
            return asked

        def configure(self, asked: dict[str, Any]) -> None:
            self.configuration = asked

        def camera_configuration(self) -> dict[str, Any]:
            return self.configuration

        def start(self) -> None: ...

        def capture_request(self, wait: float) -> Request:
            time.sleep(0.01)
            assert board.held < 6, "all buffers are held"
            return Request(self.configuration["main"]["size"])

        def close(self) -> None: ...

    class IMX500:
        camera_num = 0

        def __init__(self, network: str) -> None:
            assert Path(network).exists()

        def set_inference_roi_abs(self, region: tuple[int, ...]) -> None:
            board.regions.append(region)

        def get_outputs(self, metadata: dict[str, Any]) -> Any:
            return board.outputs or None

    modes = SimpleNamespace(Server=1, Client=2)
    controls = SimpleNamespace(rpi=SimpleNamespace(SyncModeEnum=modes))
    _install(
        monkeypatch, _module("picamera2", Picamera2=Picamera2),
        _module("picamera2.devices", IMX500=IMX500), _module("libcamera", controls=controls),
    )  # fmt: skip
    return board


# depthai 3.12.


@dataclass
class Oak:
    """An OAK: what it was asked for, and the people that its network finds."""

    asked: list[Any] = field(default_factory=list)
    people: list[Any] = field(default_factory=list)
    unplugged: bool = False
    there: tuple[str, ...] = ("14442C10",)


def oak(monkeypatch: pytest.MonkeyPatch) -> Oak:
    """Stand in for depthai; return the device."""
    found = Oak()

    def message(**more: Any) -> Any:
        taken = datetime.timedelta(seconds=time.monotonic() - 0.03)
        image = np.full((SIZE[1], SIZE[0], 3), (1, 2, 3), np.uint8)
        return SimpleNamespace(
            getTimestamp=lambda: taken, getWidth=lambda: SIZE[0], getHeight=lambda: SIZE[1],
            getType=lambda: more.get("kind", "RGB888i"), getFrame=lambda: image,
            getCvFrame=lambda: image[..., ::-1], detections=found.people,
        )  # fmt: skip

    def output(**more: Any) -> Any:
        def get(_wait: datetime.timedelta) -> Any:
            time.sleep(0.01)
            if found.unplugged:
                raise RuntimeError("Communication exception")
            return message(**more)

        return SimpleNamespace(createOutputQueue=lambda **_: SimpleNamespace(get=get))

    class Camera:
        def build(self) -> Camera:
            return self

        def requestOutput(self, size: Any, **more: Any) -> Any:
            found.asked.append((size, more))
            return output()

    class DetectionNetwork:
        out, passthrough = output(), output(kind="NV12")

        def build(self, camera: Camera, model: str, **more: Any) -> None:
            found.asked.append((model, more))

    class Device:
        def __init__(self, device: str = "") -> None:
            if device and device not in found.there:
                raise RuntimeError(f"Cannot find any device with given deviceInfo: {device}")

        @staticmethod
        def getAllAvailableDevices() -> list[Any]:
            return [SimpleNamespace(deviceId=each) for each in found.there]

        def close(self) -> None: ...

    class Pipeline:
        def __init__(self, device: Device) -> None:
            self.device = device

        def create(self, kind: Callable[[], Any]) -> Any:
            return kind()

        def start(self) -> None: ...

        def stop(self) -> None: ...

        def getDefaultDevice(self) -> Device:
            return self.device

    now = SimpleNamespace(now=lambda: datetime.timedelta(seconds=time.monotonic()))
    _install(
        monkeypatch,
        _module(
            "depthai", Device=Device, Pipeline=Pipeline, Clock=now,
            node=SimpleNamespace(Camera=Camera, DetectionNetwork=DetectionNetwork),
            ImgFrame=SimpleNamespace(Type=SimpleNamespace(RGB888i="RGB888i")),
            ImgResizeMode=SimpleNamespace(STRETCH="stretch"),
        ),
    )  # fmt: skip
    return found


def person(x: float, y: float, joints: int = 17) -> Any:
    """Return somebody of whom an OAK finds all keypoints at one place, in shares of the image."""
    point = SimpleNamespace(imageCoordinates=SimpleNamespace(x=x, y=y), confidence=0.9)
    return SimpleNamespace(getKeypoints=lambda: [point] * joints)


def _module(name: str, **members: Any) -> ModuleType:
    module = ModuleType(name)
    module.__dict__.update(members)
    return module


def _install(monkeypatch: pytest.MonkeyPatch, *modules: ModuleType) -> None:
    for module in modules:
        monkeypatch.setitem(sys.modules, module.__name__, module)
