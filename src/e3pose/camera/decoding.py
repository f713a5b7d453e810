"""Decode only the pictures that somebody needs.

H.264 and H.265 code a picture by what changed since earlier ones, back to a key frame. Packets wait
here undecoded; the next key frame makes those before it worthless. Of packets that are decoded on
the way to a needed picture, those to which no other picture refers are left out. Orders come ahead
of their slots: what waits is decoded as late as is safe, so that a picture is never late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.base.jpeg import MOST_SCANS, SCAN
from e3pose.camera.orientation import Orientation

ON_DEMAND = ("h264", "hevc", "mjpeg")  # whose key frames need nothing of what was before
DUTY = 0.5  # of the time between two frames, for packets that wait
NEWEST = 0.05  # weight of the newest packet in what one takes
# What a camera says that costs more than it has to.
WHOLE = "{}: all pictures are decoded, also those of idle slots: {}"


def decode_bounded(packet: Any) -> list[Any]:
    """Return the pictures of a packet; one that FFmpeg decodes for seconds counts as damaged.

    A JPEG may go over its picture thousands of times, and no clock is looked at meanwhile.
    """
    import av

    jpeg = packet.stream.codec_context.name == "mjpeg"
    if jpeg and bytes(packet).count(SCAN) > 2 * MOST_SCANS:  # both fields may be in a packet
        raise av.error.InvalidDataError(0, "a JPEG of too many scans")
    return list(packet.decode())


def decoded(packet: Any) -> list[Any] | None:
    """Return the pictures of a packet, see `decode_bounded`; None of one that is damaged."""
    import av

    try:
        return decode_bounded(packet)
    except av.error.FFmpegError:
        return None


class Intact:
    """Passes intact pictures on: no damaged ones, and none guessed until the next key frame.

    Pictures come out later than their packets go in. What is shown before the last key frame that
    went in may still be guessed. A key frame itself may never be shown: an edit list can begin
    behind it.

    Attributes:
        lost: packets that cannot be decoded and pictures that are not intact.
    """

    def __init__(self) -> None:
        """Begin anywhere in a stream."""
        self.lost = 0
        self._key = self._intact_from = np.inf  # times of the last key frame, of the first intact

    def of(self, packet: Any, pictures: list[Any] | None) -> list[Any]:
        """Return the intact ones of pictures.

        Args:
            packet: that was decoded.
            pictures: that came out; None where it is damaged.
        """
        if packet.is_keyframe and packet.pts is not None:
            self._key = packet.pts
            self._intact_from = min(self._intact_from, self._key)
        if pictures is None:
            self._key = self._intact_from = np.inf
            self.lost += 1
            return []
        intact = [picture for picture in pictures if self._is_intact(picture)]
        self.lost += len(pictures) - len(intact)
        return intact

    def _is_intact(self, picture: Any) -> bool:
        time = -np.inf if picture.pts is None else picture.pts
        if picture.is_corrupt:
            self._intact_from = self._key if time < self._key else np.inf
        elif picture.key_frame:
            self._intact_from = min(self._intact_from, time)
        return not picture.is_corrupt and time >= self._intact_from


class OnDemand:
    """The pictures of a stream, decoded as they are needed; for one thread.

    Attributes:
        group: packets between the newest two key frames; 0 until there were two.
        decoded: packets that were decoded.
        lost: needed pictures, the newest without a break, that were not intact.
    """

    def __init__(self, packets: Iterator[Any], context: Any) -> None:
        """Take packets in their order of decoding, with times, and the decoder."""
        self.group = self.decoded = self.lost = 0
        self._packets, self._context = packets, context
        self._waiting: deque[Any] = deque()  # packets
        self._count = self._newest_key = 0
        self._ahead: list[int] = []  # times of pictures whose turn has not come
        self._dts, self._shown = float("-inf"), -(2**63)
        self._pictures: dict[int, Any] = {}  # decoded before their turn
        self._intact = Intact()
        self._cost_s = np.inf  # of decoding a packet
        self._jumped = self._always = False

    def next(self) -> int | None:
        """Return the time of the next picture, in the stream's unit; None at the end."""
        while not self._ahead or self._ahead[0] > self._dts:
            if not self._pull():
                break
        if not self._ahead:
            return None
        self._shown = max(heappop(self._ahead), self._shown)
        return self._shown

    def picture(self, at: int) -> Any | None:
        """Return the picture of a time that does not fall; None for a damaged one."""
        self._forget(at)
        self._pictures = {when: each for when, each in self._pictures.items() if when >= at}
        # A stream is live: only a film can be asked for more.
        ahead = self._context.has_b_frames
        while not self._pictures and (self._waiting or (ahead and self._pull())):
            self._decode(at)
        found = self._pictures.pop(at, None)
        # A stream may join its pictures bit by bit, and its "key frames" be none.
        self._always |= self._jumped and found is None
        self._jumped = False
        self.lost = 0 if found is not None else self.lost + 1
        return found

    def keep_up(self, in_s: float, interval_s: float) -> None:
        """Decode what waits before the newest picture, if later would be too late.

        Args:
            in_s: until a picture may be needed.
            interval_s: between two pictures; a part of it is used.
        """
        self._forget(self._shown)
        spare = DUTY - self._cost_s / interval_s
        if spare > 0 and len(self._waiting) * self._cost_s / spare < in_s - interval_s:
            return
        end_s = perf_counter() + DUTY * interval_s
        while self._waiting and self._waiting[0].pts <= self._shown:
            self._decode(self._shown + 1)
            if perf_counter() > end_s:
                break

    def _pull(self) -> bool:
        """Take the next packet; False at the end."""
        packet = next(self._packets, None)
        if packet is None:
            self._dts = float("inf")
            return False
        if packet.pts is None:  # the last, which is empty, makes the decoder give all it has
            packet.pts = 2**62
        elif not packet.is_discard:  # by a cut without a loss
            heappush(self._ahead, packet.pts)
        self._dts = self._dts if packet.dts is None else packet.dts
        self._waiting.append(packet)
        self._count += 1
        if packet.is_keyframe:
            self.group = self._count - self._newest_key if self._newest_key else 0
            self._newest_key = self._count
        return True

    def _forget(self, at: int) -> None:
        """Drop what waits before the newest key frame that is shown by then."""
        keys = [n for n, each in enumerate(self._waiting) if each.is_keyframe and each.pts <= at]
        if not self._always and keys and keys[-1]:
            for _ in range(keys[-1]):
                self._waiting.popleft()
            self._context.flush_buffers()
            self._pictures.clear()
            self._jumped = True

    def _decode(self, needed: int) -> None:
        """Decode a packet; of pictures before a time only those to which others refer."""
        packet = self._waiting.popleft()
        self._context.skip_frame = "NONREF" if packet.pts < needed else "DEFAULT"
        begun_s = perf_counter()
        for picture in self._intact.of(packet, decoded(packet)):
            if picture.pts is not None and picture.pts >= needed:
                self._pictures[picture.pts] = picture
        took_s = perf_counter() - begun_s
        known = np.isfinite(self._cost_s)
        self._cost_s = (1 - NEWEST) * self._cost_s + NEWEST * took_s if known else took_s
        self.decoded += 1


@dataclass(slots=True, eq=False)
class Coded:
    """A picture, decoded when it is needed, at the latest before the next one; called for its RGB.

    Attributes:
        stream: that it is of; None once it is decoded.
        at: its time there.
        size: `(width, height)` that it should have, as stored.
        orientation: how it is turned.
        picture: once it is decoded.
    """

    stream: OnDemand | None
    at: int
    size: tuple[int, int]
    orientation: Orientation = field(default_factory=Orientation)
    picture: Any = None

    def decode(self) -> bool:
        """Decode it; return whether it is intact."""
        stream, self.stream = self.stream, None  # who holds the picture holds no decoder
        if stream is not None:
            found = stream.picture(self.at)
            if found is not None and (found.width, found.height) == self.size:
                self.picture = found
        return self.picture is not None

    def __call__(self) -> NDArray[np.uint8]:
        """Return `(height, width, 3)` RGB, converted and turned upright at every call."""
        if not self.decode():
            raise InputError("source", "a damaged picture", "an intact one")
        return self.orientation.apply(self.picture.to_ndarray(format="rgb24"))
