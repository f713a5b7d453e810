"""Webcams, by names that stay: Video4Linux, AVFoundation of macOS, DirectShow of Windows.

Through PyAV, not OpenCV: it says why a device cannot be opened and what the device gave, has the
kernel's time of each frame and names on every system, and a picture is decoded only where somebody
looks at it (docs/decisions/0015-webcams-through-pyav.md).
"""

from __future__ import annotations

import errno
import re
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.system import group_of, video_input
from e3pose.camera.base import LiveFrame, SourceSettings, mark_of, taken_ns
from e3pose.camera.decoding import decode_bounded

DEV, SYS = Path("/dev"), Path("/sys")
ON_LINUX = re.compile(r"\d{1,3}|by-(id|path)/[A-Za-z0-9_.:,+@-]+")
V4L2 = "video4linux2,v4l2"
# The size that all webcams of the last decade have as MJPG, and a network's input seldom exceeds.
USUAL_SIZE, USUAL_FPS = (1280, 720), 30.0
READ_S, OPEN_S = 1.0, 5.0
# With another format these come again.
FINAL = {*(errno.EACCES, errno.EPERM, errno.EBUSY, errno.ENOSPC, errno.ENOENT, errno.ENODEV)}
# A quarter of the shortest interval, 1/60 s; frames have the kernel's time all the same.
POLL_S = 0.004
# A device that is not asked to wait: one whose sensor hangs would stop this thread for ever.
NONBLOCK = "nobuffer+4"
# tuned: bits per pixel | a webcam's best MJPG; cameras reserve more than they send | the demo's
#   films as JPEG have 1.7 at quality 95, 2.3 at 98 and 3.5 at 100
MJPG_BITS = 3.0
USB2_MBIT = 0.8 * 480  # what USB 2.0 leaves to cameras, by its specification (5.7.4)


@dataclass(slots=True, eq=False)
class WebcamSource:
    """A webcam, found by its name each time that it is opened.

    Attributes:
        name: what follows `usb:`.
        clock: of the camera.
        asked_fps: frames per second to ask for.
        asked_size: `(width, height)` to ask for, pixels.
        dev: where devices are.
        fps: that the device gives.
        note: what was asked for and given, where these differ; empty where they do not.
    """

    name: str
    clock: Clock
    asked_fps: float = USUAL_FPS
    asked_size: tuple[int, int] = USUAL_SIZE
    dev: Path = DEV
    fps: float = USUAL_FPS
    note: str = ""
    _container: Any = None
    _stream: Any = None
    _decoding: threading.Lock = field(default_factory=threading.Lock)

    def open(self) -> None:
        """See `LiveSource.open`."""
        import av

        system, (width, height) = video_input(), self.asked_size
        options = {"video_size": f"{width}x{height}", "framerate": f"{self.asked_fps:g}"}
        forms: tuple[dict[str, str], ...] = ({},)
        if system == V4L2:
            place = str(device_of(self.name, self.dev))
            forms = ({"input_format": "mjpeg"}, {})  # raw pictures crowd the hub
        else:
            place = f"video={self.name}" if system == "dshow" else f"{self.name}:none"
        for form in forms:
            asked = {**options, **form, "fflags": NONBLOCK}
            try:
                container = av.open(place, format=system, options=asked, timeout=(OPEN_S, READ_S))
                self._container, self._stream = container, container.streams.video[0]
                break
            except (av.FFmpegError, OSError, IndexError, ValueError) as error:
                if form is forms[-1] or getattr(error, "errno", None) in FINAL:
                    found, expected = _reason(error, Path(place))
                    raise InputError(f"source usb:{self.name}", found, expected) from None
        self._notice()

    def _notice(self) -> None:
        """Note the actual rate of the device, and differences from the requested settings."""
        context = self._stream.codec_context
        self.fps, self.note = float(self._stream.average_rate or self.asked_fps), ""
        given, (width, height) = (context.width, context.height), self.asked_size
        if given != self.asked_size or abs(self.fps / self.asked_fps - 1) > 0.02:
            kind = "MJPG" if context.name == "mjpeg" else context.pix_fmt
            self.note = (
                f"source usb:{self.name}: gives {kind} {given[0]}x{given[1]} at {self.fps:.3g} "
                f"frames per second, asked for {width}x{height} at {self.asked_fps:.3g}"
            )

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        end_s = time.monotonic() + READ_S
        while self._container is not None and time.monotonic() < end_s:
            try:
                packet = next(self._container.demux(self._stream), None)
            except BlockingIOError:
                time.sleep(POLL_S)
                continue
            except OSError as error:  # FFmpeg's errors of devices are such
                self.close()
                raise InputError(f"source usb:{self.name}: {reason_of(error)}") from None
            if packet is None or not packet.size:
                self.close()
                raise InputError(f"source usb:{self.name}: ended")
            return self._frame(packet)
        return None

    def _frame(self, packet: Any) -> LiveFrame:
        context, now_ns = self._stream.codec_context, self.clock.now_ns()
        kernel_ns = round((packet.pts or 0) * packet.time_base * 1_000_000_000)
        captured_ns = taken_ns(now_ns, time.monotonic_ns() - kernel_ns)  # where it is that clock's
        size = context.width, context.height

        def image() -> NDArray[np.uint8]:
            return self._decoded(packet, size)

        return LiveFrame(captured_ns, size, image, lambda: mark_of(image()))

    def _decoded(self, packet: Any, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return a picture, `(height, width, 3)` RGB; all black where it cannot be decoded."""
        with self._decoding:
            try:
                image: NDArray[np.uint8] = decode_bounded(packet)[-1].to_ndarray(format="rgb24")
            except (OSError, ValueError, IndexError):  # a damaged picture
                image = np.zeros((size[1], size[0], 3), np.uint8)
        return image

    def close(self) -> None:
        """See `LiveSource.close`."""
        container, self._container = self._container, None
        if container is not None:
            container.close()


def _reason(error: Exception, place: Path) -> tuple[str, str]:
    """Return why a device cannot be opened, and what to do."""
    number = getattr(error, "errno", None)
    if number in (errno.EACCES, errno.EPERM):
        group = group_of(place) or "video"
        return (
            f"no permission to read {place}",
            f"membership of the group {group}: sudo usermod -aG {group} $USER, then log in again",
        )
    if number == errno.EBUSY:
        return f"{place} in use by another program", "a free device"
    if number == errno.ENOSPC:
        return (
            "no bandwidth left on its USB hub",
            "a smaller size or fps of the cameras there, or a port of another hub",
        )
    return reason_of(error), "a webcam that films"


def device_of(name: str, dev: Path = DEV) -> Path:
    """Return the device of a webcam; its name alone where devices are no files.

    Args:
        name: `0`, or `by-id/NAME` or `by-path/NAME` as in `/dev/v4l`.
        dev: where devices are.

    Raises:
        InputError: for a name that is none, or of no device: another one is never taken instead.
    """
    check_name(name)
    if video_input() != V4L2:
        return Path(name)
    place = dev / f"video{name}" if name.isdigit() else dev / "v4l" / name
    if not place.exists():
        there = ", ".join(find_devices(dev)) or "none"
        raise InputError(f"source usb:{name}", f"no {place}", f"it plugged in; there is: {there}")
    return place.resolve()


def check_name(name: str) -> None:
    """Raise `InputError` for a name that no webcam can have on this system."""
    if video_input() == V4L2:
        good = ON_LINUX.fullmatch(name) is not None
        expected = "usb:by-id/NAME as `e3pose init` lists it, or usb:NUMBER"
    else:
        good = bool(name) and name.isprintable() and not {'"', ":"} & {*name}
        expected = "usb:NAME as `e3pose init` lists it"
    if not good:
        raise InputError("source", repr(f"usb:{name}"[:80]), expected)


def make_webcam(asked: SourceSettings) -> WebcamSource:
    """Return the webcam of a source `usb:NAME`."""
    check_name(asked.name)
    fps, size = asked.fps or USUAL_FPS, asked.size or USUAL_SIZE
    return WebcamSource(asked.name, asked.clock, fps, size)


def find_devices(dev: Path = DEV, sys: Path = SYS) -> dict[str, str]:
    """Return the webcams of this machine: source such as `usb:by-id/NAME` to its title.

    Two of one model without serial numbers share a name: they are named by the ports that they are
    plugged into, and devices without either by their number.

    Args:
        dev: where devices are.
        sys: where the system tells of them.
    """
    if (system := video_input()) != V4L2:
        from av import device

        titles = [each.description for each in device.enumerate_input_devices(system)]
        return {f"usb:{title}": title for title in titles}
    nodes = dict(sorted(_titles(sys)))
    by_id, by_path = _links(dev / "v4l/by-id"), _links(dev / "v4l/by-path")
    alike = {nodes[number] for number in nodes if f"video{number}" not in by_id}
    found = {}
    for number, title in nodes.items():
        named = by_path if title in alike else {**by_path, **by_id}
        found[f"usb:{named.get(f'video{number}', number)}"] = title
    return found


def _links(folder: Path) -> dict[str, str]:
    """Return the lasting names of devices, such as `by-id/NAME` of `video0`."""
    links = sorted(folder.glob("*-index0"))
    return {link.resolve().name: f"{folder.name}/{link.name}" for link in links}


def lasting(source: str, dev: Path = DEV, sys: Path = SYS) -> str:
    """Return the source of a webcam by the name that it keeps; another source as it is.

    Args:
        source: such as `usb:0`.
        dev: where devices are.
        sys: where the system tells of them.
    """
    if not re.fullmatch(r"usb:\d{1,3}", source) or video_input() != V4L2:
        return source
    node = f"video{int(source.removeprefix('usb:'))}"
    places = {device_of(each.removeprefix("usb:"), dev).name: each for each in
              find_devices(dev, sys)}  # fmt: skip
    return places.get(node, source)


def _titles(sys: Path) -> Iterator[tuple[int, str]]:
    for device in (sys / "class/video4linux").glob("video*"):
        number = device.name.removeprefix("video")
        try:
            first = (device / "index").read_text(encoding="utf-8").strip() == "0"
            title = " ".join((device / "name").read_text(encoding="utf-8").split())[:60]
        except OSError:
            continue
        if first and number.isdigit():  # others are its metadata
            yield int(number), title


def crowded_hubs(
    cameras: Mapping[str, tuple[str, tuple[int, int] | None, float | None]],
    dev: Path = DEV,
    sys: Path = SYS,
) -> Iterator[tuple[list[str], str]]:
    """Yield the webcams that share a USB 2 port which cannot carry all of them, and what to do.

    Args:
        cameras: by name, the source, and the size and rate to ask for.
        dev: where devices are.
        sys: where the system tells of them.
    """
    if video_input() != V4L2:
        return
    ports: dict[str, dict[str, float]] = {}
    for camera_id, (source, size, fps) in cameras.items():
        scheme, _, name = source.partition(":")
        try:
            node = device_of(name, dev).name if scheme == "usb" else ""
        except InputError:  # said elsewhere
            continue
        port = _usb2_port((sys / "class/video4linux" / node / "device").resolve())
        width, height = size or USUAL_SIZE
        mbit = MJPG_BITS * width * height * (fps or USUAL_FPS) / 1e6
        if port:
            ports.setdefault(port, {})[camera_id] = mbit
    for port, needs in ports.items():
        if len(needs) > 1 and (total := sum(needs.values())) > USB2_MBIT:
            share = USB2_MBIT / total
            yield (
                list(needs),
                f"share the USB 2 port {port}: about {total:.0f} Mbit/s of MJPG, it carries "
                f"{USB2_MBIT:.0f}: fps below {share:.0%} of the rate, a smaller size, or other "
                "ports",
            )


def _usb2_port(place: Path) -> str:
    """Return the port of the host, such as `1-2`, to which a device of USB 2 leads; else empty."""
    devices = [part for part in place.parts if re.fullmatch(r"\d+-[\d.]+", part)]
    if not devices:
        return ""
    own = place.parents[len(place.parts) - 2 - place.parts.index(devices[-1])] / "speed"
    try:
        return devices[0] if float(own.read_text(encoding="ascii")) <= 480 else ""
    except (OSError, ValueError):
        return ""
