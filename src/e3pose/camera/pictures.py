"""Small pictures of a camera's frames for operators, made on request and never stored.

An image leaves the camera only where its own configuration allows it, one for each question, and
never more than five a second. The newest image is held in memory until the next one.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.runtime.clock import Clock
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Picture

WIDTH = 320
QUALITY = 60  # of JPEG: 10 to 20 kB
PERIOD_NS = 200_000_000
ASKED_NS = 2_000_000_000  # images are held for so long after a question


class Pictures:
    """Holds the newest image while pictures are requested; thread-safe.

    Attributes:
        watts: what the device drew last, for the energy of making a picture.
    """

    def __init__(self, camera_id: str, clock: Clock) -> None:
        """Begin without an image.

        Args:
            camera_id: whose pictures they are.
            clock: the camera's.
        """
        self.watts: float | None = None
        self._camera_id, self._clock = camera_id, clock
        self._asked_ns: int | None = None
        self._image: tuple[NDArray[np.uint8], int] | None = None
        self._made: Picture | None = None
        self._made_ns = 0
        self._spent_j, self._count = 0.0, 0
        self._lock = threading.Lock()

    def offer(self, image: Any, slot: int) -> None:
        """Keep the image of a slot if pictures were requested recently; else drop the last one.

        Args:
            image: `(height, width, 3)` RGB; what a simulated source shows is no image.
            slot: in which it was detected.
        """
        asked_ns = self._asked_ns
        wanted = asked_ns is not None and self._clock.now_ns() - asked_ns < ASKED_NS
        shown = isinstance(image, np.ndarray) and image.ndim == 3
        self._image = (image, slot) if wanted and shown else None

    def answer(self, _topic: str, _payload: bytes) -> bytes | None:
        """Answer a request for a picture; None while there is none."""
        with self._lock:
            now_ns = self._asked_ns = self._clock.now_ns()
            newest = self._image
            if newest is None:
                return None
            if self._made is None or now_ns - self._made_ns >= PERIOD_NS:
                self._made, self._made_ns = self._make(*newest, now_ns), now_ns
            return encode(self._made)

    def _make(self, image: NDArray[np.uint8], slot: int, begun_ns: int) -> Picture:
        import cv2

        height, width = image.shape[:2]
        size = (min(WIDTH, width), max(1, round(height * min(WIDTH, width) / width)))
        small: Any = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        coded: Any = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        took_s = (self._clock.now_ns() - begun_ns) / 1e9
        self._spent_j += (self.watts or 0.0) * took_s
        self._count += 1
        return Picture(
            self._camera_id, slot, (width, height), coded[1].tobytes(), self._count, self._spent_j
        )
