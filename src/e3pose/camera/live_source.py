"""Live sources of frames: devices, streams, files and recordings at their own pace.

    usb:by-id/NAME               a webcam by the name that it keeps; usb:0 is `/dev/video0`
    rtsp://HOST/PATH             a network camera; http:// likewise
    secret:FILE                  a private file with the address of one, and its password
    env:NAME                     likewise a variable of the environment
    phone:FILE                   a phone whose page sends frames; `e3pose phone FILE` makes the file
    gstreamer:PIPELINE           a GStreamer pipeline, through PyGObject
    picamera2:0                  a camera of a Raspberry Pi; imx500:0 is its AI Camera: it detects
    depthai:ID                   an OAK; depthai:ID?model=NAME has it detect
    VIDEO.mp4                    a file at its own pace, again and again
    FOLDER                       its images, at --fps
    recorded:RECORDING           the keypoints of a recording, for trying a site without cameras
    module:Name                  one of your own; packages offer schemes as `e3pose.sources`

Files and recordings begin at the place that the time of day says, so that all cameras of a site on
one machine, or on machines with the same time, show the same moment.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.masking import masked
from e3pose.base.plugins import is_offered, is_own, maker
from e3pose.camera.base import LiveFrame, LiveSource, SourceSettings, mark_of
from e3pose.camera.decoding import ON_DEMAND, WHOLE, Coded, Intact, OnDemand, decoded
from e3pose.camera.gstreamer import make_pipeline
from e3pose.camera.oak import make_oak
from e3pose.camera.phone import PhoneSource
from e3pose.camera.phone_file import load_phone
from e3pose.camera.picamera import make_picamera, make_sensor
from e3pose.camera.source import (
    DECODER,
    FALLBACK_RATE,
    MAX_PIXELS,
    Video,
    VideoSource,
    open_video,
    read_picture,
)
from e3pose.camera.webcam import make_webcam
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, load_recording
from e3pose.settings.sources import PHONE, place_of, revealed, scheme_of

READ_S = 1.0
STREAMS = ("rtsp", "rtsps", "http", "https")
IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".webp")
OPEN_TIMEOUT_US = 5_000_000
LONG_GROUP_S = 2.0  # between key frames: more than orders are ahead
MOST_LOST = 250  # pictures: more than may come before a key frame


Frames = Callable[[float], Iterator[tuple[float, Callable[[], Any]]]]


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """Frames that repeat after their end.

    Attributes:
        fps: frames per second.
        image_size: `(width, height)` in pixels.
        length_s: of one round.
        frames: the frames from a time on, with the times since the beginning of the round.
    """

    fps: float
    image_size: tuple[int, int]
    length_s: float
    frames: Frames


def slower(loop: Loop, pace: float) -> Loop:
    """Return a loop played at `pace` times its speed."""

    def frames(start_s: float) -> Iterator[tuple[float, Callable[[], Any]]]:
        for time_s, image in loop.frames(start_s * pace):
            yield time_s / pace, image

    return Loop(loop.fps * pace, loop.image_size, loop.length_s / pace, frames)


@dataclass(slots=True, eq=False)
class PacedSource:
    """A loop, played at its own pace; frames that are late already are left out.

    Attributes:
        loop: the frames.
        clock: of the camera.
        begin_s: of a round.
        note: see `AskedSource`.
    """

    loop: Loop
    clock: Clock
    begin_s: float = 0.0
    note: str = ""
    _stream: OnDemand | None = None  # of the newest picture, where it is decoded on demand
    _needed_ns: int = 0  # when the next picture is
    _playing: Iterator[tuple[float, Callable[[], Any]]] | None = None
    _round_ns: int = 0
    _ahead: tuple[float, Callable[[], Any]] | None = None

    @property
    def fps(self) -> float:
        """See `LiveSource.fps`."""
        return self.loop.fps

    def open(self) -> None:
        """See `LiveSource.open`."""
        length_ns = round(self.loop.length_s * 1e9)
        begin_ns = round(self.begin_s * 1e9)
        now_ns = max(self.clock.now_ns(), begin_ns)
        self._round_ns = now_ns - (now_ns - begin_ns) % length_ns
        self._playing = self.loop.frames((now_ns - self._round_ns) / 1e9)
        self._ahead = self._stream = None

    def need(self, in_s: float) -> None:
        """See `OnDemandSource.need`."""
        self._needed_ns = self.clock.now_ns() + round(in_s * 1e9)
        if self._stream is not None:
            self._stream.keep_up(in_s, 1 / self.fps)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        begun_ns = self.clock.now_ns()
        while self.clock.now_ns() - begun_ns < READ_S * 1e9:
            due = self._ahead or self._next()
            due_ns = self._round_ns + round(due[0] * 1e9)
            wait_s = (due_ns - self.clock.now_ns()) / 1e9
            if wait_s > READ_S:
                self._ahead = due
                self._wait(self.clock.now_ns() + round(READ_S * 1e9))
                return None
            self._ahead = None
            if wait_s < -READ_S:  # the machine was busy, or asleep
                continue
            frame = LiveFrame(due_ns, self.loop.image_size, due[1])
            self._stream = None
            if isinstance(due[1], Coded):
                self._stream = due[1].stream
                frame = replace(frame, decode=due[1].decode)
                if due_ns >= self._needed_ns and not due[1].decode():  # ready before it is due
                    continue
            self._wait(due_ns)
            return frame
        return None

    def _wait(self, until_ns: int) -> None:
        self.clock.wait(threading.Event(), until_ns)

    def close(self) -> None:
        """See `LiveSource.close`."""
        self._playing = self._stream = None
        self._needed_ns = 0

    def _next(self) -> tuple[float, Callable[[], Any]]:
        for _ in range(2):
            found = None if self._playing is None else next(self._playing, None)
            if found is not None:
                return found
            self._round_ns += round(self.loop.length_s * 1e9)
            self._playing = self.loop.frames(0.0)
        raise InputError("source: found no frames")


class RecordedSource(PacedSource):
    """The keypoints of a recording as if its camera saw them now."""

    def __init__(
        self,
        recording: Recording,
        camera_id: str,
        clock: Clock,
        pace: float = 1.0,
        begin_s: float = 0.0,
    ) -> None:
        self.skeleton, self.detector = recording.skeleton, recording.detector
        camera = recording.rig.index(camera_id)
        series, interval_s = recording.views[camera], recording.interval_s

        def frames(start_s: float) -> Iterator[tuple[float, Callable[[], Any]]]:
            for slot in range(round(start_s / interval_s + 0.499), recording.num_slots):
                # A camera that lost a frame saw nobody.
                shown = series.view(slot) or Poses2D.empty(len(recording.skeleton))
                yield slot * interval_s, lambda shown=shown: shown  # type: ignore[misc]

        size, length_s = recording.rig.cameras[camera].image_size, recording.num_slots * interval_s
        loop = Loop(recording.fps, size, length_s, frames)
        super().__init__(slower(loop, pace), clock, begin_s)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`; without images, poses are shown in their place."""
        frame = super().read()
        return None if frame is None else replace(frame, poses=frame.image)


@dataclass(slots=True, eq=False)
class StreamSource:
    """A network camera (RTSP or HTTP).

    Attributes:
        url: its address.
        clock: of the camera.
        fps: that it states.
        note: see `AskedSource`.
    """

    url: str
    clock: Clock
    fps: float = FALLBACK_RATE
    note: str = ""
    _container: Any = None
    _frames: Iterator[Coded] | None = None
    _pictures: OnDemand | None = None  # where they are decoded on demand
    _needed: bool = True
    _single: bool = False  # whether each picture is coded by itself
    _whole: bool = False  # as decoding on demand failed, such as where B-frames come unannounced

    def open(self) -> None:
        """See `LiveSource.open`."""
        import av

        options = {"fflags": "nobuffer", **DECODER}
        if self.url.startswith("rtsp"):
            options |= {"rtsp_transport": "tcp", "stimeout": str(OPEN_TIMEOUT_US)}
        why = ""
        try:
            self._container = av.open(self.url, options=options, timeout=(5.0, READ_S * 2))
            stream = self._container.streams.video[0]
            if (codec := stream.codec_context) is None:
                raise ValueError("a format without a decoder")
            if codec.width * codec.height > MAX_PIXELS:
                raise ValueError(f"pictures of more than {MAX_PIXELS} pixels")
            codec.options = DECODER
            self._frames = self._coded(self._container.demux(stream), codec)
            # Other codecs send what did not change once, also of a still room.
            self._single = codec.name == "mjpeg"
            self.fps = float(stream.average_rate or self.fps)
        except (av.FFmpegError, OSError, IndexError, ValueError) as error:
            why = reason_of(error)[:200]
        if why:  # FFmpeg's "input/output error" is the camera's fault: it is no cause of this one
            raise InputError(f"source {masked(self.url)[:200]}: {why}")

    def _coded(self, packets: Iterator[Any], context: Any) -> Iterator[Coded]:
        """Yield pictures as they come, decoded already where that cannot wait."""
        self._pictures, where = None, f"source {masked(self.url)[:80]}"
        if context.name in ON_DEMAND and not (context.has_b_frames or self._whole):
            pictures = self._pictures = OnDemand(_numbered(packets), context)
            self.note = ""
            while (at := pictures.next()) is not None and pictures.lost <= MOST_LOST:
                yield Coded(pictures, at, (context.width, context.height))
                if (group_s := pictures.group / self.fps) > LONG_GROUP_S:
                    why = f"a key frame comes every {group_s:.2g} s, not every second"
                    self.note = WHOLE.format(where, why)
            self._whole = pictures.lost > MOST_LOST
            return  # opened again
        other = f"it is {context.name}, not H.264, H.265 or MJPG"
        self.note = WHOLE.format(where, "it has B-frames" if context.name in ON_DEMAND else other)
        intact = Intact()
        for packet in packets:
            for picture in intact.of(packet, decoded(packet)) or [None]:
                yield Coded(None, 0, (context.width, context.height), picture=picture)

    def need(self, in_s: float) -> None:
        """See `OnDemandSource.need`."""
        self._needed = False
        if self._pictures is not None:
            self._pictures.keep_up(in_s, 1 / self.fps)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        import av

        try:
            coded = None if self._frames is None else next(self._frames, None)
        except (av.FFmpegError, OSError):
            coded = None
        if coded is None:
            self.close()
            time.sleep(READ_S / 2)
            with suppress(InputError):
                self.open()
            return None
        now_ns = self.clock.now_ns()
        if (self._needed or coded.stream is None) and not coded.decode():
            return None

        def mark() -> int:
            if not coded.decode():
                return now_ns
            return mark_of(coded.picture.to_ndarray(format="gray"))

        shown = mark if self._single else None
        return LiveFrame(now_ns, coded.size, coded, shown, decode=coded.decode)

    def close(self) -> None:
        """See `LiveSource.close`."""
        container, self._container, self._frames = self._container, None, None
        self._pictures, self._needed = None, True
        if container is not None:
            container.close()


def _numbered(packets: Iterator[Any]) -> Iterator[Any]:
    """Give packets their number as time: streams may have none, or begin anew."""
    for number, packet in enumerate(packets):
        if packet.size:
            packet.pts = packet.dts = number
            yield packet


def _pictures(video: Video, start_s: float) -> Iterator[tuple[float, Callable[[], Any]]]:
    for frame in video.frames(start_s):
        yield frame.time_s, lambda frame=frame: frame.image  # type: ignore[misc]


def _images(folder: Path, fps: float) -> Loop:
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGES)
    if not paths:
        raise InputError(f"{folder}: found no image in it, expected {', '.join(IMAGES)}")

    def frames(start_s: float) -> Iterator[tuple[float, Callable[[], Any]]]:
        for index in range(round(start_s * fps + 0.499), len(paths)):
            yield index / fps, lambda path=paths[index]: read_picture(path)  # type: ignore[misc]

    height, width = read_picture(paths[0]).shape[:2]
    return Loop(fps, (width, height), len(paths) / fps, frames)


def make_source(
    name: str,
    camera_id: str,
    clock: Clock,
    fps: float | None = None,
    pace: float = 1.0,
    begin_s: float = 0.0,
    size: tuple[int, int] | None = None,
) -> LiveSource:
    """Return the source that a name means; see the top of this module.

    Args:
        name: `SCHEME:WHAT`, of `SOURCES` or an installed package; a file or folder; `module:Name`.
        camera_id: see `SourceSettings`, likewise what follows.
        clock: of the camera.
        fps: to ask for.
        pace: of what was recorded.
        begin_s: of a round.
        size: to ask for.

    Raises:
        InputError: when it can be seen already that there is no such source.
    """
    name = revealed(name)
    scheme, place = scheme_of(name), place_of(name)
    live = place is None or name.startswith(PHONE)
    if pace != 1 and live:
        raise InputError("pace", f"{pace:g}", "1: live cameras cannot play slower")
    own = live and is_own(name) and not is_offered(GROUP, scheme, SOURCES)
    key = name if own else scheme or "file"
    rest = name if "://" in name else name[len(scheme) + 1 :] if scheme else name
    make = maker(GROUP, "source", key, SOURCES, more=", a video, a folder of images")
    return make(SourceSettings(rest, camera_id, clock, fps, size, pace, begin_s))


def _stream(asked: SourceSettings) -> LiveSource:
    if "://" not in asked.name:
        raise InputError("source", repr(masked(asked.name)[:80]), "rtsp://HOST/PATH or http://HOST")
    return StreamSource(asked.name, asked.clock)


def _phone(asked: SourceSettings) -> LiveSource:
    load_phone(Path(asked.name))  # an error of it is said here
    return PhoneSource(Path(asked.name), asked.clock)


def _recording(asked: SourceSettings) -> LiveSource:
    recording = load_recording(Path(asked.name))
    return RecordedSource(recording, asked.camera_id, asked.clock, asked.pace, asked.begin_s)


def _file(asked: SourceSettings) -> LiveSource:
    path, note = Path(asked.name), ""
    if path.is_dir():
        loop = _images(path, asked.fps or 25.0)
    else:
        video = open_video(path)
        frames: Frames = partial(_pictures, video)
        if isinstance(video, VideoSource) and video.on_demand:
            frames = video.coded
        else:
            note = WHOLE.format(path, "it is not one file of H.264 or H.265 (MP4, MKV, TS)")
        loop = Loop(video.rate, video.image_size, video.num_frames / video.rate, frames)
    return PacedSource(slower(loop, asked.pace), asked.clock, asked.begin_s, note)


GROUP = "e3pose.sources"  # the entry points of other packages
# By scheme. To add one: a maker and a line here, or a package; the contract test then runs it.
SOURCES: dict[str, Callable[[SourceSettings], LiveSource]] = {
    "usb": make_webcam,
    **dict.fromkeys(STREAMS, _stream),
    "phone": _phone,
    "gstreamer": make_pipeline,
    "picamera2": make_picamera,
    "imx500": make_sensor,
    "depthai": make_oak,
    "recorded": _recording,
    "file": _file,
}
