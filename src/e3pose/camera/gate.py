"""The motion gate: where the image is that of the last look, the network need not run.

A small grey image is compared with that of the last look, whole, so that whoever comes in is seen.
Not with the frame before: slow motion adds up until it shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from e3pose.camera.base import LiveDetector
from e3pose.detectors.focus import detect_expected
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import MOST_UNCHANGED_S, Poses2D

# Pixels of the small image: somebody 1/20 of the image high is 8 of them, with fewer he is lost in
# one; with more every comparison takes longer. The two thresholds below are measured at this size.
LONG_SIDE = 160
SAMPLES = 4  # along each side, for the mean of one of its pixels
# tuned: grey levels | lab/experiments/2026-11-26-cheaper-looks.md: somebody 1/20 of the image high
#   who came in is missed in 1 of 170 images, noise of 12 grey levels in none | 16: in 1 of 23
CHANGED = 12
# tuned: px | as above | 6: misses somebody so small in 1 of 4 images
FEWEST_CHANGED = 3  # pixels that changed: one or two may be noise


def small_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the small image of a `(height, width, 3)` one, `(small_height, small_width)`."""
    import cv2

    height, width = image.shape[:2]
    scale = LONG_SIDE / max(height, width)
    columns, rows = max(round(scale * width), 1), max(round(scale * height), 1)
    sampled = cv2.resize(image, (SAMPLES * columns, SAMPLES * rows), interpolation=cv2.INTER_LINEAR)
    grey = cv2.cvtColor(sampled, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


class Gate:
    """Looks with a network, but where the image is unchanged; for one thread.

    Attributes:
        detector: the network.
    """

    def __init__(self, detector: LiveDetector, on: bool) -> None:
        """Create a gate; one that is not on always looks."""
        self.detector, self._on = detector, on
        self._small: NDArray[np.uint8] | None = None  # of the last look, and below what it found
        self._found, self._whole, self._looked_ns = Poses2D.empty(0), False, 0

    def look(
        self,
        image: NDArray[np.uint8],
        expected: ExpectedView | None,
        captured_ns: int,
        begin: Callable[[], None] = lambda: None,
    ) -> Poses2D:
        """Return the people in a frame: found now, or in the last look where it is unchanged since.

        A look at a part of the image says nothing of the rest: a look at all of it is taken.

        Args:
            image: `(height, width, 3)` RGB.
            expected: people expected in it; None asks for the whole image.
            captured_ns: when it was taken, by the camera's clock.
            begin: called before the network runs, if it does.
        """
        if not self._on:
            begin()
            return detect_expected(self.detector, image, expected)
        small, since_s = small_grey(image), (captured_ns - self._looked_ns) / 1e9
        before, covers = self._small, self._whole or expected is not None
        recent = covers and 0 < since_s <= MOST_UNCHANGED_S
        if recent and before is not None and small.shape == before.shape:
            apart = np.abs(small.astype(np.int16) - before)
            if (apart > CHANGED).sum() < FEWEST_CHANGED:
                return replace(self._found, unchanged_s=since_s)
        begin()
        self._found = detect_expected(self.detector, image, expected)
        self._small, self._looked_ns, self._whole = small, captured_ns, expected is None
        return self._found
