"""Find the cameras of this machine, and read one frame of a source."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.camera.live_source import make_source
from e3pose.camera.source import open_video
from e3pose.errors import InputError
from e3pose.runtime.clock import WallClock

FRAME_S = 10.0  # for a device to open and give its first frame
DARK = 8.0  # mean of 0..255 below which a picture shows nothing
VIDEO4LINUX = Path("/sys/class/video4linux")


@dataclass(frozen=True, slots=True)
class Probe:
    """Properties of a source, from one frame.

    Attributes:
        source: its name.
        image_size: `(width, height)` in pixels.
        fps: frames per second.
        dark: whether the frame shows nothing.
    """

    source: str
    image_size: tuple[int, int]
    fps: float
    dark: bool


def probe(
    source: str, camera_id: str = "", fps: float | None = None, timeout_s: float = FRAME_S
) -> Probe:
    """Open a source, read its first frame and close it.

    Args:
        source: see `camera.live_source`.
        camera_id: of the camera, for recordings of several.
        fps: frames per second to ask for.
        timeout_s: how long to wait for the frame.

    Raises:
        InputError: when there is no such source, or no frame comes in time.
    """
    if Path(source).is_file():
        video = open_video(Path(source))
        first = next(iter(video.frames()))
        return Probe(source, video.image_size, video.rate, _dark(first.image))
    opened = make_source(source, camera_id, WallClock(), fps)
    opened.open()
    try:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            if (frame := opened.read()) is not None:
                return Probe(source, frame.image_size, opened.fps, _dark(frame.image()))
    finally:
        opened.close()
    raise InputError("source", f"no frame of {source[:80]} in {timeout_s:g} s", "one that films")


def _dark(shown: Any) -> bool:
    return isinstance(shown, np.ndarray) and bool(shown.mean() < DARK)


def find_devices(folder: Path = VIDEO4LINUX) -> dict[str, str]:
    """Return the Video4Linux cameras of this machine: source such as `usb:0` to its name.

    Args:
        folder: in which the system tells of them.
    """
    found: dict[int, str] = {}
    for device in folder.glob("video*"):
        number = device.name.removeprefix("video")
        try:
            first = (device / "index").read_text().strip() == "0"  # others are its metadata
            name = " ".join((device / "name").read_text().split())[:60]
        except OSError:
            continue
        if first and number.isdigit():
            found[int(number)] = name
    return {f"usb:{number}": found[number] for number in sorted(found)}
