"""Protocols of a camera: a source of frames and a detector."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from e3pose.model.pose import Poses2D


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """A frame as it comes from a source.

    Attributes:
        captured_ns: when it was taken, by the camera's clock.
        image_size: `(width, height)` in pixels.
        image: returns what is to be detected in: an RGB image `(height, width, 3)`, or whatever the
            detector of a simulated source takes. It is converted when it is first asked for.
        mark: returns a number that frames share only where they are the same; None where a source
            repeats the frames of a still room, as films and most codecs do.
    """

    captured_ns: int
    image_size: tuple[int, int]
    image: Callable[[], Any]
    mark: Callable[[], int] | None = None

    def shared(self) -> LiveFrame:
        """Return a frame for several threads, which converts its image once."""
        lock, seen = threading.Lock(), list[Any]()

        def image() -> Any:
            with lock:
                if not seen:
                    seen.append(self.image())
                return seen[0]

        return replace(self, image=image)


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
        """Return the next frame, waiting at most a second; None if there is none."""
        ...

    def close(self) -> None:
        """Stop capturing and release the device; `open` may follow."""
        ...


class LiveDetector(Protocol):
    """Detects people in frames; every `detectors.Detector` does."""

    def detect(self, image: Any) -> Poses2D:
        """Return the people, pixels of that image."""
        ...


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """What a camera is.

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
