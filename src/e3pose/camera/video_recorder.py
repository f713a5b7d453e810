"""Record a camera as videos of some minutes each, within bounded disk space.

A frame per slot, whether the camera is active in it or not, on a thread of its own: a slow disk or
encoder loses frames of the video, never of the camera.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.bounded import bytes_of
from e3pose.base.clock import SlotTimes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import make_file, make_folder
from e3pose.camera.base import LiveFrame
from e3pose.recording.videos import MAX_BYTES, PART_S, part_of, video_name, videos_in

# Write a video that stays readable if the program is killed.
#
# Matroska, because a file that was cut off is still one. MPEG-4 part 2, because its encoder is the
# fastest of FFmpeg's own, which need no GPL: half the processor time of VP9 at the same quality,
# for twice the bytes.

CODEC = "mpeg4"
QSCALE = 4  # of 1 to 31: 40 dB of the frames themselves
TICKS = 1000  # a second; Matroska's
KEY_FRAME_S = 1.0  # so that what a kill cuts off is a second


class VideoFile:
    """A video that is being written, with the times at which its frames were taken.

    Attributes:
        path: the file.
        image_size: `(width, height)` of its frames; an odd last row or column is cut off.
    """

    def __init__(self, path: Path, image_size: tuple[int, int], fps: float) -> None:
        """Begin a file.

        Args:
            path: does not exist yet; ends in `.mkv`.
            image_size: `(width, height)` of the frames to come, in pixels.
            fps: frames per second, about.

        Raises:
            OSError: when it cannot be written.
        """
        import av

        self.path, self.image_size = path, image_size
        make_file(path)  # for its owner alone
        options = {"flush_packets": "1", "cluster_time_limit": str(round(1000 * KEY_FRAME_S))}
        self._container: Any = av.open(str(path), "w", format="matroska", options=options)
        rate = Fraction(fps).limit_denominator(1001)
        self._stream: Any = self._container.add_stream(CODEC, rate=rate)
        self._stream.width, self._stream.height = (side - side % 2 for side in image_size)
        self._stream.pix_fmt = "yuv420p"
        context = self._stream.codec_context
        context.time_base = Fraction(1, TICKS)
        context.thread_count = 1  # the network has the others
        context.gop_size = max(1, round(fps * KEY_FRAME_S))
        context.qmin = context.qmax = QSCALE
        self._last = -1

    def add(self, image: NDArray[np.uint8], time_s: float) -> None:
        """Append a frame; one that is not later than the last is left out.

        Args:
            image: `(height, width, 3)` RGB.
            time_s: when it was taken, seconds after the first.

        Raises:
            OSError: when it cannot be written.
        """
        import av

        tick = round(time_s * TICKS)
        if tick <= self._last:
            return
        self._last = tick
        width, height = self._stream.width, self._stream.height
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(image[:height, :width]), format="rgb24"
        )
        frame.pts, frame.time_base = tick, Fraction(1, TICKS)
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file.

        Raises:
            OSError: when it cannot be written.
        """
        container, self._container = self._container, None
        if container is None:
            return
        try:
            container.mux(self._stream.encode(None))
        finally:
            container.close()


QUEUE_FRAMES = 8
TRIM_S = 5.0  # of the scene
RETRY_S = 10.0  # after a disk that was full


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """Settings for recording a camera's frames.

    Attributes:
        folder: of its videos.
        camera_id: whose they are.
        part_s: length of one, in seconds of the scene; they begin where the edge's recordings do.
        max_bytes: of all videos in the folder; the oldest go first.
        pace: seconds of the scene that pass in a second.
        busy_w: what a second of processor time is taken to draw beyond an idle device.
    """

    folder: Path
    camera_id: str
    part_s: float = PART_S
    max_bytes: int = MAX_BYTES
    pace: float = 1.0
    busy_w: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    frame: LiveFrame
    edge_ns: int
    part: tuple[int, int]  # session of the edge, number of the part
    fps: float


class VideoRecorder:
    """Encodes on a thread of its own; `offer` returns at once.

    Attributes:
        recorded: frames written.
        dropped: frames that found no room, as the encoder or the disk was too slow.
        busy_s: processor time that converting and encoding took.
    """

    def __init__(self, settings: VideoSettings, report: Callable[[str], None]) -> None:
        """Begin without a file.

        Args:
            settings: what to record.
            report: called with messages for operators, from the recorder's thread.

        Raises:
            InputError: when the folder cannot be made.
        """
        self.settings, self._report = settings, report
        try:
            make_folder(settings.folder)
        except OSError as error:
            raise InputError(f"videos: {settings.folder}: {reason_of(error)}") from None
        self.recorded = self.dropped = 0
        self.busy_s = 0.0
        self._told_dropped = False
        self._frames: deque[_Taken] = deque()
        self._change = threading.Condition()
        self._closed = False
        self._file: VideoFile | None = None
        self._part = (0, -1)
        self._begin_ns = self._trim_ns = self._retry_ns = 0
        self._problem = ""
        self._thread = threading.Thread(target=self._work, name="video", daemon=True)
        self._thread.start()

    @property
    def spent_j(self) -> float:
        """Joules that recording took so far, by the model of its settings."""
        return self.busy_s * self.settings.busy_w

    def offer(
        self, frame: LiveFrame, edge_ns: int, session: int, slot: int, times: SlotTimes
    ) -> None:
        """Queue the frame of a slot; it is dropped if the queue is full.

        Args:
            frame: what was captured.
            edge_ns: when, by the edge's clock.
            session: of the edge, which counts its slots from 0.
            slot: for which it stands.
            times: where slots lie.
        """
        fps = 1e9 / (times.interval_ns * self.settings.pace)
        part = part_of(slot, fps, self.settings.part_s)
        with self._change:
            if len(self._frames) >= QUEUE_FRAMES:
                self.dropped += 1
                return
            self._frames.append(_Taken(frame, edge_ns, (session, part), fps))
            self._change.notify()

    def close(self) -> None:
        """Write the queued frames and finish the video."""
        with self._change:
            self._closed = True
            self._change.notify()
        self._thread.join(timeout=10.0)

    def _work(self) -> None:
        while (taken := self._next()) is not None:
            begun_s = time.thread_time()
            if taken.edge_ns >= self._retry_ns and not self._write(taken):
                self._retry_ns = taken.edge_ns + round(RETRY_S * 1e9)
            self.busy_s += time.thread_time() - begun_s
        self._try(self._finish)

    def _next(self) -> _Taken | None:
        with self._change:
            while not self._frames and not self._closed:
                self._change.wait()
            return self._frames.popleft() if self._frames else None

    def _write(self, taken: _Taken) -> bool:
        """Write a frame; return whether it succeeded. Reports when problems begin and end."""
        done = self._try(lambda: self._put(taken))
        if done and self._problem:
            self._report("recording video again")
            self._problem = ""
        if self.dropped and not self._told_dropped:
            self._told_dropped = True
            self._report("video: frames are left out, encoder or disk is too slow")
        return done

    def _try(self, action: Callable[[], None]) -> bool:
        try:
            action()
        except (OSError, ValueError) as error:  # PyAV's errors are both
            reason = reason_of(error)
            if not self._problem:
                self._report(f"not recording video: {reason.lower()}")
            self._problem, self._file = reason, None
            return False
        return True

    def _put(self, taken: _Taken) -> None:
        image = taken.frame.image()
        if not (isinstance(image, np.ndarray) and image.ndim == 3):
            raise ValueError("the source has keypoints, no images")
        size = (image.shape[1], image.shape[0])
        file = self._file
        if file is None or taken.part != self._part or file.image_size != size:
            self._finish()
            self._part = taken.part
            self._begin_ns = self._trim_ns = taken.edge_ns // 1000 * 1000
            self._trim()
            path = self.settings.folder / video_name(self.settings.camera_id, taken.edge_ns)
            file = self._file = VideoFile(path, size, taken.fps)
        file.add(image, (taken.edge_ns - self._begin_ns) / 1e9 * self.settings.pace)
        self.recorded += 1
        if taken.edge_ns - self._trim_ns > TRIM_S * 1e9 / self.settings.pace:
            self._trim_ns = taken.edge_ns
            if not self._trim():
                self._finish()  # it alone is larger: begin another, so that it can go

    def _finish(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _trim(self) -> bool:
        """Delete the oldest videos beyond the space; return whether the rest fits."""
        videos = videos_in(self.settings.folder)
        sizes = [bytes_of(path) for path in videos]
        left = sum(sizes)
        for path, size in zip(videos, sizes, strict=True):
            if left <= self.settings.max_bytes:
                return True
            if self._file is not None and path == self._file.path:
                return False
            path.unlink(missing_ok=True)
            left -= size
        return True
