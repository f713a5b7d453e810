"""Hostile videos: what each is, and the verbs that read it."""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from e3pose.base.clock import WallClock
from e3pose.camera.live_source import make_source
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from hostile_trials import Trial, measured, tried

WIDTH, HEIGHT = 64, 48
Make = Callable[[Path], object]


class Nobody:
    """A detector that finds nobody, at once."""

    skeleton = COCO17

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        """Return no people."""
        return Poses2D(np.zeros((0, 17, 2)), np.zeros((0, 17)))


def film(
    path: Path,
    count: int = 10,
    times_ms: list[int] | None = None,
    codec: str = "mpeg4",
    turned: int | None = None,
    still: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    drop: Callable[[Any], bool] = lambda packet: False,
    at_ms: Callable[[int], int] | None = None,
    **options: str,
) -> Path:
    """Write a video of noise.

    Args:
        path: the file.
        count: frames.
        times_ms: of the frames; every 50 ms by default.
        codec: of FFmpeg.
        turned: degrees that its display matrix says.
        still: whether all frames are the same, so that few are key frames.
        size: of its images.
        drop: packets to leave out.
        at_ms: changes the times of packets.
        options: of the container.
    """
    rng = np.random.default_rng(0)
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream(codec, rate=20)
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        if turned is not None:
            stream.set_display_rotation(turned)
        container.start_encoding()
        frames: list[Any] = [None] if not count else []
        for i in range(count):
            if not (still and i):
                image = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts = 50 * i if times_ms is None else times_ms[i]
            frame.time_base = Fraction(1, 1000)
            frames.append(frame)
        for frame in [*frames, None]:
            for packet in stream.encode(frame) if count else []:
                if at_ms is not None:
                    packet.pts = packet.dts = at_ms(packet.pts)
                if not drop(packet):
                    container.mux(packet)
    return path


def cut(part: float, **options: Any) -> Make:
    """Make a writer of the first part of a video."""

    def make(path: Path) -> None:
        data = film(path, 40, **options).read_bytes()
        path.write_bytes(data[: int(len(data) * part)])

    return make


def patched(find: bytes, at: int, put: bytes, **options: Any) -> Make:
    """Make a writer of a video with bytes overwritten `at` behind the first place of `find`."""

    def make(path: Path) -> None:
        data = bytearray(film(path, **options).read_bytes())
        begin = data.index(find) + at
        data[begin : begin + len(put)] = put
        path.write_bytes(data)

    return make


def patched_everywhere(find: bytes, put: bytes, **options: Any) -> Make:
    """Make a writer of a video with bytes replaced everywhere."""

    def make(path: Path) -> None:
        data = film(path, **options).read_bytes()
        assert find in data
        path.write_bytes(data.replace(find, put))

    return make


def jpeg_of(size: int) -> Make:
    """Make a writer of a film of JPEGs whose own headers state another size than the file's."""
    own = struct.pack(">HH", HEIGHT, WIDTH)

    def make(path: Path) -> None:
        data = bytearray(film(path, codec="mjpeg").read_bytes())
        at = data.find(b"\xff\xc0")
        while at >= 0:
            assert data[at + 5 : at + 9] == own
            data[at + 5 : at + 9] = struct.pack(">HH", size, size)
            at = data.find(b"\xff\xc0", at + 9)
        path.write_bytes(data)

    return make


def jpegs_of_scans(count: int) -> Make:
    """Make a writer of a film of JPEGs that scan a picture of 1920 x 1080 so many times."""

    def make(path: Path) -> None:
        grey = np.full((1080, 1920, 3), 90, np.uint8)
        coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
        again = coded[coded.rindex(b"\xff\xda") : -2]
        with av.open(str(path), "w") as container:
            stream = container.add_stream("mjpeg", rate=20)
            stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuvj420p"
            container.start_encoding()
            for number in range(5):
                packet = av.Packet(coded if number % 2 else coded[:-2] + count * again + coded[-2:])
                packet.stream, packet.time_base = stream, Fraction(1, 20)
                packet.pts = packet.dts = number
                packet.is_keyframe = True
                container.mux(packet)

    return make


VIDEOS: dict[str, tuple[str, Make]] = {
    "half of a file": ("a.avi", cut(0.5)),
    "half of a file, its index first": ("a.mp4", cut(0.5, movflags="faststart")),
    "half of a file, its index lost": ("a.mp4", cut(0.5)),
    "200 bytes": ("a.mkv", lambda p: p.write_bytes(film(p).read_bytes()[:200])),
    "no byte": ("a.mp4", lambda p: p.write_bytes(b"")),
    "zeros": ("a.mp4", lambda p: p.write_bytes(bytes(10**6))),
    "no frame": ("a.mkv", lambda p: film(p, 0)),
    "no frame, MP4": ("a.mp4", lambda p: film(p, 0)),
    "one frame": ("a.mkv", lambda p: film(p, 1)),
    "header of 65535 x 65535": (
        "a.avi", patched(b"strf", 12, struct.pack("<ii", 65535, 65535), codec="mjpeg"),
    ),
    "header of -64 x -48": (
        "a.avi", patched(b"strf", 12, struct.pack("<ii", -64, -48), codec="mjpeg"),
    ),
    "JPEGs of 60000 x 60000": ("a.avi", jpeg_of(60000)),
    "JPEGs of 20000 x 20000": ("a.avi", jpeg_of(20000)),
    "size that changes": ("a.avi", jpeg_of(32)),
    "codec that is none": ("a.mp4", patched_everywhere(b"mp4v", b"XxXx")),
    "codec of another kind": ("a.avi", patched_everywhere(b"FMP4", b"H264")),
    "sound called video": ("a.avi", patched(b"vids", 0, b"auds")),
    "10^9 frames per second": ("a.avi", patched(b"vids", 20, struct.pack("<II", 1, 10**9))),
    "one frame in 136 years": ("a.avi", patched(b"vids", 20, struct.pack("<II", 2**32 - 1, 1))),
    "rate 0": ("a.avi", patched(b"vids", 20, struct.pack("<II", 0, 0))),
    "2^32 frames announced": ("a.avi", patched(b"vids", 32, struct.pack("<I", 2**32 - 1))),
    "variable rate": ("a.mkv", lambda p: film(p, 6, [0, 1, 500, 501, 7000, 9000])),
    "a gap of 11 days": ("a.mkv", lambda p: film(p, 4, [0, 50, 10**9, 10**9 + 50])),
    "a gap of 31 years": ("a.mkv", lambda p: film(p, 4, [0, 50, 10**12, 10**12 + 50])),
    "all at one time": ("a.mkv", lambda p: film(p, at_ms=lambda time_ms: 0)),
    "negative timestamps": (
        "a.mkv", lambda p: film(p, 10, [50 * i - 300 for i in range(10)], avoid_negative_ts="0"),
    ),
    "negative timestamps, MP4": (
        "a.mp4", lambda p: film(p, 10, [50 * i - 300 for i in range(10)], avoid_negative_ts="0"),
    ),
    "turned by 90 degrees": ("a.mp4", lambda p: film(p, turned=90)),
    "turned by 37 degrees": ("a.mp4", lambda p: film(p, turned=37)),
    "no key frame": (
        "a.mkv", lambda p: film(p, 30, still=True, drop=lambda packet: packet.is_keyframe),
    ),
    "2^31 samples announced": (
        "a.mp4", patched(b"stsz", 8, struct.pack(">II", 1, 2**31 - 1)),
    ),
    "JPEGs of 20 000 scans": ("a.avi", jpegs_of_scans(20_000)),
    "2 x 2 pixels": ("a.mkv", lambda p: film(p, size=(2, 2))),
}  # fmt: skip


def try_video(path: Path, name: str, init: bool) -> Iterator[Trial]:
    """Give a video to all readers of videos; `init` takes seconds with good ones."""
    here = f"{Path(__file__).resolve()}:Nobody"
    dest = path.parent / "dest"
    yield tried(name, "detect", ["detect", str(path), str(dest), "--model", here])
    site = path.parent / "site"
    if init:
        sources = [f"cam0={path}", f"cam1={path}"]
        yield tried(name, "init", ["init", str(site), *sources, "--detector", here, "--fps", "5"])
    yield measured(name, "camera", lambda: played(path))


def played(path: Path) -> str:
    """Play a video as a camera does, for some frames."""
    clock = WallClock()
    source = make_source(str(path), "cam", clock, None)
    with contextlib.closing(source):
        source.open()
        shown = 0
        begun_s = time.monotonic()
        while shown < 5 and time.monotonic() - begun_s < 2.0:
            frame = source.read()
            if frame is not None:
                frame.image()
                shown += 1
    return f"{shown} frames at {source.fps:g} per second"
