"""Resize and pad an image for a network, and map keypoints back to the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.detectors.base import Image


@dataclass(frozen=True, slots=True)
class Fit:
    """Where an image lies in a network's input.

    Attributes:
        input_size: `(width, height)` of the network's input.
        content_size: `(width, height)` the image takes in it.
        corner: `(x, y)` of the input pixel that holds the image's top-left pixel.
        image_size: `(width, height)` of the image.
    """

    input_size: tuple[int, int]
    content_size: tuple[int, int]
    corner: tuple[int, int]
    image_size: tuple[int, int]

    def apply(self, image: Image, fill: int) -> Image:
        """Return the `(input_height, input_width, 3)` input, `fill` around the image."""
        import cv2

        resized: Any = image
        if self.content_size != self.image_size:
            # Area averaging, because interpolation skips pixels when it shrinks by more than two.
            shrinks = self.content_size[0] < self.image_size[0]
            method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            resized = cv2.resize(image, self.content_size, interpolation=method)
        if self.content_size == self.input_size:
            return np.asarray(resized)
        canvas = np.full((self.input_size[1], self.input_size[0], 3), fill, dtype=np.uint8)
        x, y = self.corner
        canvas[y : y + self.content_size[1], x : x + self.content_size[0]] = resized
        return canvas

    def to_image(self, points: NDArray[Any]) -> Floats:
        """Map `(*batch, 2)` input pixels to image pixels; both count from pixel centres."""
        content = np.asarray(points, dtype=np.float64) + 0.5 - np.asarray(self.corner)
        scale = np.asarray(self.image_size) / np.asarray(self.content_size)
        return np.asarray(content * scale - 0.5)

    def to_input(self, points: NDArray[Any]) -> Floats:
        """Map `(*batch, 2)` image pixels to input pixels; the inverse of `to_image`."""
        scale = np.asarray(self.content_size) / np.asarray(self.image_size)
        content = (np.asarray(points, dtype=np.float64) + 0.5) * scale
        return np.asarray(content + np.asarray(self.corner) - 0.5)


def stretch(image_size: tuple[int, int], input_size: tuple[int, int]) -> Fit:
    """Fill the whole input, whatever that does to the image's proportions."""
    return Fit(input_size, input_size, (0, 0), image_size)


def letterbox(
    image_size: tuple[int, int], input_size: tuple[int, int], centred: bool = False
) -> Fit:
    """Keep the image's proportions, at the input's top-left corner or at its centre."""
    scale = min(input_size[0] / image_size[0], input_size[1] / image_size[1])
    width, height = (
        min(max(round(side * scale), 1), limit)
        for side, limit in zip(image_size, input_size, strict=True)
    )
    corner = ((input_size[0] - width) // 2, (input_size[1] - height) // 2) if centred else (0, 0)
    return Fit(input_size, (width, height), corner, image_size)


def letterbox_to_side(image_size: tuple[int, int], long_side: int, multiple: int) -> Fit:
    """Keep the proportions in the smallest input with this long side and sides of this multiple."""
    scale = long_side / max(image_size)
    content = tuple(max(round(side * scale), 1) for side in image_size)
    width, height = (-(-side // multiple) * multiple for side in content)
    return Fit((width, height), (content[0], content[1]), (0, 0), image_size)
