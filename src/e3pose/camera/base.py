"""Protocols of a camera: a source of frames and a detector."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton

MAX_AGE_NS = 1_000_000_000  # of a frame that comes; an older one has the time of another clock


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """A frame as it comes from a source.

    Attributes:
        captured_ns: when it was taken, by the camera's clock.
        image_size: `(width, height)` in pixels.
        image: returns what is to be detected in, an RGB image `(height, width, 3)`; its poses where
            a source that detects has no images. It is converted when it is first asked for.
        mark: returns a number that frames share only where they are the same; None where a source
            repeats the frames of a still room, as films and most codecs do.
        poses: returns who is in it, pixels of `image_size`; None where the camera's detector has to
            look.
        decode: makes its image ready, and returns whether it is intact; to be called before the
            next `read` by who needs the image. None where images are ready.
    """

    captured_ns: int
    image_size: tuple[int, int]
    image: Callable[[], Any]
    mark: Callable[[], int] | None = None
    poses: Callable[[], Poses2D] | None = None
    decode: Callable[[], bool] | None = None

    def shared(self) -> LiveFrame:
        """Return a frame for several threads, which converts its image once."""
        lock, seen = threading.Lock(), list[Any]()

        def image() -> Any:
            with lock:
                if not seen:
                    seen.append(self.image())
                return seen[0]

        return replace(self, image=image)


def mark_of(rows: NDArray[np.uint8]) -> int:
    """Return a number of a picture by every fourth of its rows, which all have noise."""
    return zlib.crc32(rows[::4].tobytes())


def taken_ns(now_ns: int, age_ns: int) -> int:
    """Return when a frame was taken that is so old now; now where its age makes no sense."""
    return now_ns - age_ns if 0 <= age_ns < MAX_AGE_NS else now_ns


class LiveSource(Protocol):
    """A source of frames, at its own rate."""

    @property
    def fps(self) -> float:
        """Frames per second, about."""
        ...

    def open(self) -> None:
        """Begin; raise `InputError` saying why it cannot."""
        ...

    def read(self) -> LiveFrame | None:
        """Return the next frame, waiting at most a second; None if there is none.

        Raises:
            InputError: why there will be none any more, after closing itself; `open` may follow.
        """
        ...

    def close(self) -> None:
        """Stop capturing and release the device; `open` may follow."""
        ...


@runtime_checkable
class AskedSource(LiveSource, Protocol):
    """A source that is asked for a size and a rate.

    Attributes:
        note: once it is open, what it gives instead, or costs more than it has to; else empty.
    """

    note: str


@runtime_checkable
class OnDemandSource(AskedSource, Protocol):
    """A source that decodes the frames that are needed, once it is told when that will be."""

    def need(self, in_s: float) -> None:
        """Note in how many seconds a frame may be needed; called before each `read`."""
        ...


@runtime_checkable
class DetectingSource(LiveSource, Protocol):
    """A source whose frames have poses: a sensor that detects, or a recording.

    Attributes:
        skeleton: the joint axis of its poses.
        detector: what finds them, the name of their noise model.
    """

    skeleton: Skeleton
    detector: str


@runtime_checkable
class SteeredSource(DetectingSource, Protocol):
    """One that can detect in a part of the image."""

    def expect(self, expected: ExpectedView | None) -> None:
        """Detect where people are expected from the next frame on; None for the whole image."""
        ...


@dataclass(frozen=True, slots=True)
class SourceSettings:
    """Settings of a source of frames.

    Attributes:
        name: what follows its scheme: `0` of `usb:0`; all of a source that has none.
        camera_id: of the camera, for recordings of several.
        clock: of the camera.
        fps: frames per second to ask for; None for the source's own.
        size: `(width, height)` to ask for, pixels; None for the source's own.
        pace: how fast what was recorded is played; 0.1 is a tenth of its speed.
        begin_s: when a round of it begins, since 1970; nothing is shown before.
    """

    name: str
    camera_id: str
    clock: Clock
    fps: float | None = None
    size: tuple[int, int] | None = None
    pace: float = 1.0
    begin_s: float = 0.0


class LiveDetector(Protocol):
    """Detects people in frames; every `detectors.Detector` does."""

    def detect(self, image: Any) -> Poses2D:
        """Return the people, pixels of that image."""
        ...


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Settings of a camera node.

    Attributes:
        site: its site.
        camera_id: its name there.
        joints: that its detector finds.
        wake_s: from aggressive power-saving to the first frame.
        delay_ns: how long after the moment it shows a frame has its time.
        detector: name of the network.
        battery_wh: capacity; None on mains.
        rests: how it may sleep, of `wire.messages.RESTING`.
        gate: whether the network rests where the image is unchanged.
    """

    site: str
    camera_id: str
    joints: tuple[str, ...]
    wake_s: float = 0.0
    delay_ns: int = 0
    detector: str = ""
    battery_wh: float | None = None
    rests: tuple[str, ...] = ()
    gate: bool = False
