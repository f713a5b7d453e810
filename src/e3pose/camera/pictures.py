"""Small pictures of a camera's frames for operators, made on request and never stored.

An image leaves the camera only where its own configuration allows it, one for each question, and
never more than five a second. Only images in which the camera detects anyway are shown: the newest
is held in memory, so that a camera that sleeps shows its last one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Picture, PictureQuestion

WIDTH, LARGE_WIDTH = 320, 960
QUALITY = 60  # of JPEG
PERIOD_NS = 200_000_000
GROUND, FIGURE = (236, 238, 241), (120, 128, 140)  # of a picture drawn from keypoints, RGB
NEVER = "no detection yet"
NO_IMAGES = "its source shows no images"


@dataclass(frozen=True, slots=True, eq=False)
class _Newest:
    image: Callable[[], Any]
    slot: int
    edge_ns: int
    size: tuple[int, int]


class Pictures:
    """Holds the newest image for pictures; thread-safe.

    Attributes:
        watts: what the device drew last, for the energy of making a picture.
    """

    def __init__(self, camera_id: str, clock: Clock, limbs: Sequence[tuple[int, int]] = ()) -> None:
        """Begin without an image.

        Args:
            camera_id: whose pictures they are.
            clock: the camera's.
            limbs: of its keypoints, for a source that plays keypoints instead of images.
        """
        self.watts: float | None = None
        self._camera_id, self._clock, self._limbs = camera_id, clock, limbs
        self._newest: _Newest | None = None
        self._made: dict[int, tuple[Picture, int]] = {}  # by width, and when it was made
        self._spent_j, self._count = 0.0, 0
        self._lock = threading.Lock()

    def offer(
        self, image: Callable[[], Any], slot: int, edge_ns: int, size: tuple[int, int]
    ) -> None:
        """Hold the image of a slot until the next one.

        Args:
            image: returns `(height, width, 3)` RGB, or the keypoints that a simulated source shows.
            slot: in which it was detected.
            edge_ns: when it was captured, by the edge's clock.
            size: `(width, height)` of the frame in pixels.
        """
        self._newest = _Newest(image, slot, edge_ns, size)

    def answer(self, _topic: str, payload: bytes) -> bytes | None:
        """Answer a request for a picture; None for one that makes no sense."""
        try:
            asked = decode(payload, PictureQuestion, "viewer") if payload else PictureQuestion()
        except InputError:
            return None
        with self._lock:
            newest = self._newest
            if newest is None:
                return encode(self._none(NEVER))
            width, now_ns = LARGE_WIDTH if asked.large else WIDTH, self._clock.now_ns()
            made, made_ns = self._made.get(width, (None, 0))
            if made is None or (
                made.captured_edge_ns != newest.edge_ns and now_ns - made_ns >= PERIOD_NS
            ):
                if (found := self._make(newest, width, now_ns)) is None:
                    return encode(self._none(NO_IMAGES))
                made, self._made[width] = found, (found, now_ns)
            had = asked.have_ns > 0 and asked.have_ns == made.captured_edge_ns
            return encode(self._none("") if had else made)

    def _none(self, why: str) -> Picture:
        return Picture(self._camera_id, 0, (1, 1), b"", self._count, self._spent_j, why=why)

    def _make(self, newest: _Newest, width: int, begun_ns: int) -> Picture | None:
        """Return the picture of an image; None where the source has none."""
        import cv2

        (full_width, full_height), image = newest.size, newest.image()
        drawn = isinstance(image, Poses2D)
        if not drawn:
            if not (isinstance(image, np.ndarray) and image.ndim == 3):
                return None
            full_height, full_width = image.shape[:2]
        width = min(width, full_width)
        size = (width, max(1, round(full_height * width / full_width)))
        if drawn:
            small: Any = self._draw(image, size, width / full_width)
        else:
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        coded: Any = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        took_s = (self._clock.now_ns() - begun_ns) / 1e9
        self._spent_j += (self.watts or 0.0) * took_s
        self._count += 1
        return Picture(
            self._camera_id, newest.slot, (full_width, full_height), coded[1].tobytes(),
            self._count, self._spent_j, newest.edge_ns, drawn,
        )  # fmt: skip

    def _draw(self, poses: Poses2D, size: tuple[int, int], scale: float) -> NDArray[np.uint8]:
        """Return keypoints as grey figures, `(height, width, 3)` RGB, for want of an image."""
        import cv2

        image = np.full((size[1], size[0], 3), GROUND, dtype=np.uint8)
        thick = max(1, round(size[0] / 160))
        for keypoints_px, scores in zip(poses.keypoints_px, poses.scores, strict=True):
            seen = (scores > 0) & np.isfinite(keypoints_px).all(axis=-1)
            places = np.where(seen[:, None], keypoints_px * scale, 0.0)
            points = [tuple(p) for p in np.clip(places, -1e4, 1e4).round().astype(int).tolist()]
            for i, j in self._limbs:
                if seen[i] and seen[j]:
                    cv2.line(image, points[i], points[j], FIGURE, thick, cv2.LINE_AA)
            for index in np.flatnonzero(seen):
                cv2.circle(image, points[index], thick + 1, FIGURE, -1, cv2.LINE_AA)
        return image
