"""Live thumbnails of cameras that no program of a site has yet, with the frame rate measured.

A source is opened when somebody looks and closed when nobody does, or when a program of the site
needs the device. Pictures are held in memory and never stored.
"""

from __future__ import annotations

import base64
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera.base import LiveFrame, LiveSource
from e3pose.camera.frame_rate import rate_hz
from e3pose.camera.live_source import make_source
from e3pose.camera.orientation import Orientation

WIDTH, QUALITY = 480, 70
UNSEEN_S = 6.0  # after which a source that nobody looks at is closed
COUNT_S = 4.0  # of frames of which the rate is measured
STALE_S = 3.0  # after which a picture is said to be old
END_S = 8.0
MAX_FRAMES = 2000

Open = Callable[[str], LiveSource]


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """The newest picture of a camera, or the reason for none.

    Attributes:
        jpeg: as base64; None where there is no picture.
        size: `(width, height)` of the frame in pixels.
        fps: measured, frames per second; None while too few came.
        why: there is no picture, in words.
    """

    jpeg: str | None
    size: tuple[int, int]
    fps: float | None
    why: str = ""

    def body(self) -> dict[str, Any]:
        """Return it for the page."""
        return {"jpeg": self.jpeg, "size": self.size, "fps": self.fps, "why": self.why}


class Thumbnails:
    """The sources on view, each read on its own thread."""

    def __init__(self, opened: Open | None = None) -> None:
        """Begin with none.

        Args:
            opened: makes a source of its name, not open yet; by default a real one.
        """
        self._make = opened or (lambda name: make_source(name, "", WallClock(), None))
        self._readers: dict[str, _Reader] = {}
        self._lock = threading.Lock()

    def look(self, source: str, rotation: int = 0) -> Thumbnail:
        """Return the newest picture of a source, and open it at the first look.

        Args:
            source: what a camera sees.
            rotation: degrees clockwise by which the picture is turned.
        """
        with self._lock:
            self._forget()
            reader = self._readers.get(source)
            if reader is None:
                reader = self._readers[source] = _Reader(source, self._make)
        return reader.thumbnail(rotation)

    def close(self, *sources: str) -> None:
        """Close some sources, or all, and wait until their devices are free."""
        with self._lock:
            named = sources or tuple(self._readers)
            ended = [self._readers.pop(name) for name in named if name in self._readers]
        for reader in ended:
            reader.stop.set()
        for reader in ended:
            reader.thread.join(END_S)

    def _forget(self) -> None:
        for name in [n for n, each in self._readers.items() if not each.thread.is_alive()]:
            if self._readers[name].stop.is_set():
                del self._readers[name]


class _Reader:
    """Reads one source until it is off view."""

    def __init__(self, source: str, make: Open) -> None:
        self.source, self.stop = source, threading.Event()
        self._make, self._seen_s, self._why = make, time.monotonic(), ""
        self._frame: LiveFrame | None = None
        self._times_ns: deque[int] = deque(maxlen=MAX_FRAMES)
        self._came, self._came_s = threading.Event(), 0.0
        self.thread = threading.Thread(target=self._run, name="setup-thumbnail", daemon=True)
        self.thread.start()

    def thumbnail(self, rotation: int) -> Thumbnail:
        self._seen_s = time.monotonic()
        self._came.wait(1.0)  # for the first frame
        frame = self._frame
        if frame is None:
            return Thumbnail(None, (0, 0), None, self._why or "waiting for its first picture")
        old_s = time.monotonic() - self._came_s
        why = self._why or (f"no picture for {old_s:.0f} s" if old_s > STALE_S else "")
        rate = None if why else self._rate()
        return Thumbnail(_jpeg(frame.image(), rotation), frame.image_size, rate, why)

    def _rate(self) -> float | None:
        times = [t for t in tuple(self._times_ns) if t > self._times_ns[-1] - COUNT_S * 1e9]
        found = rate_hz(times)
        return None if found is None else round(found, 1)

    def _run(self) -> None:
        try:
            source = self._make(self.source)
            source.open()
        except (InputError, OSError) as error:
            self._why = str(error)
            self._came.set()
            self._linger()
            return
        try:
            while not self.stop.is_set() and time.monotonic() - self._seen_s < UNSEEN_S:
                if (frame := source.read()) is not None:
                    self._frame = frame.shared()
                    self._times_ns.append(frame.captured_ns)
                    self._came_s = time.monotonic()
                    self._came.set()
        except (InputError, OSError) as error:
            self._why = str(error)
            self._linger()
        finally:
            self.stop.set()
            source.close()

    def _linger(self) -> None:
        """Keep the reason while the source is on view, then allow another try."""
        self.stop.wait(UNSEEN_S)
        self.stop.set()


def _jpeg(image: Any, rotation: int) -> str | None:
    """Return an image made small, as a JPEG in base64; None where a source shows no images."""
    import cv2

    if not (isinstance(image, np.ndarray) and image.ndim == 3):
        return None
    turned = Orientation.from_degrees(rotation).apply(image)
    height, width = turned.shape[:2]
    scale = min(1.0, WIDTH / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(turned, size, interpolation=cv2.INTER_AREA)
    coded: Any = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return base64.b64encode(coded[1].tobytes()).decode()
