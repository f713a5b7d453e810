"""Detect in the part of an image where people are expected, at the network's best scale."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image
from e3pose.detectors.fit import letterbox_to_side
from e3pose.detectors.mosaic import Mosaic, mosaic_of
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

MARGIN = 0.15  # of a person's size, around keypoints: heads and feet reach beyond
LARGEST_SCALE = 2.0  # enlarging more shows no more
SMALLEST_PERSON_PX = 16.0  # somebody smaller is not what the scale is chosen for


@dataclass(frozen=True, slots=True)
class Part:
    """A rectangle of an image, and how large the network gets it.

    Attributes:
        left: first column.
        top: first row.
        width: columns.
        height: rows.
        long_side: of the network's input in pixels, where the network leaves it free.
    """

    left: int
    top: int
    width: int
    height: int
    long_side: int

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)`."""
        return self.width, self.height

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom."""
        return self.left, self.top, self.left + self.width, self.top + self.height

    def cut(self, image: Image) -> Image:
        """Return the part of a `(height, width, 3)` image."""
        columns = slice(self.left, self.left + self.width)
        return image[self.top : self.top + self.height, columns]

    def in_image(self, poses: Poses2D) -> Poses2D:
        """Return poses in pixels of the part as those of the image."""
        return Poses2D(poses.keypoints_px + (self.left, self.top), poses.scores)


class InputSize(Protocol):
    """The input of a network whose scale is free.

    Attributes:
        person_px: how large people should be in its input, between the keypoints farthest apart;
            larger ones cost more than they tell.
        long_side: of its input for a whole image, pixels.
        multiple: the sides of its input are multiples of this.
    """

    person_px: float
    long_side: int
    multiple: int


@runtime_checkable
class Focusing(InputSize, Protocol):
    """A detector that can detect in a part of an image."""

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """Return the people in a part of `image`, in pixels of `image`.

        Those who are expected may help to find joints.
        """
        ...


class InParts(Focusing):
    """A detector for which a whole image is one part of it."""

    def detect(self, image: Image) -> Poses2D:
        """Return the people in a `(height, width, 3)` RGB image, in its pixels."""
        width, height = check_image(image)
        return self.detect_part(image, Part(0, 0, width, height, self.long_side))


@runtime_checkable
class InBoxes(Protocol):
    """A detector that finds the keypoints of one person at a time, in a box around each."""

    def detect_in_boxes(self, image: Image, boxes: NDArray[np.float64]) -> Poses2D:
        """Return the people in these boxes, in pixels of `image`; nobody where nobody is.

        Args:
            image: `(height, width, 3)` RGB.
            boxes: `(num_persons, 4)` x, y of two corners, from the outer edge of the first pixel.
        """
        ...


def uses_feedback(detector: Any) -> bool:
    """Return whether a detector uses feedback about where people are expected."""
    return isinstance(detector, Focusing | InBoxes)


def check_feedback(detector: Any, name: str) -> None:
    """Raise `InputError` unless a detector of this name uses feedback."""
    if not uses_feedback(detector):
        found = f"with {name[:80] or 'a detector'}, which detects in whole images alone"
        raise InputError("feedback", found, "a detector with detect_part or detect_in_boxes")


def detect_expected(detector: Any, image: Any, expected: ExpectedView | None) -> Poses2D:
    """Return the people in an image, of whom some are expected.

    Args:
        detector: a `Detector`; one that is neither `Focusing` nor `InBoxes` detects in the whole
            image.
        image: what it detects in.
        expected: who is expected where; None detects in the whole image.
    """
    look: Part | Mosaic | None = None
    if expected is not None and uses_feedback(detector):
        height, width = image.shape[:2]
        if isinstance(detector, InBoxes):
            boxes = boxes_of(expected, (width, height))
            if len(boxes):
                return detector.detect_in_boxes(image, boxes)
        else:
            look = look_at(expected, (width, height), detector)
    if look is None or expected is None:
        whole: Poses2D = detector.detect(image)
        return whole
    if isinstance(look, Mosaic):
        (width, height), shown = look.size, look.expected(expected)
        input_ = Part(0, 0, width, height, max(look.size))
        return look.in_image(detector.detect_part(look.draw(image), input_, shown))
    found: Poses2D = detector.detect_part(image, look, expected)
    return found


def look_at(
    expected: ExpectedView, image_size: tuple[int, int], network: InputSize
) -> Part | Mosaic | None:
    """Return where to look for everybody who is expected: in one part, or in crops of them.

    Crops are for networks whose input may have any size (`free_input`). The way with larger people
    is chosen, up to the size that the network needs, else that with fewer pixels of input; neither
    has more than detection in the whole image.

    Args:
        expected: who is expected where.
        image_size: `(width, height)` in pixels.
        network: that detects.

    Returns:
        Where; None for the whole image.
    """
    boxes, sizes_px = _boxes(expected, image_size), _sizes_px(expected)
    part, relative_size = _part(boxes, sizes_px, image_size, network)
    if not getattr(network, "free_input", False):
        return part
    inside, seen = boxes
    mosaic = mosaic_of(
        np.where(seen[:, None], inside, np.nan),
        sizes_px,
        network.person_px,
        LARGEST_SCALE,
        network.multiple,
        _input_pixels(None, image_size, network),
    )
    if mosaic is None:
        return part
    pixels = _input_pixels(part, image_size, network)
    better = (-mosaic.relative_size, mosaic.pixels) < (-relative_size, pixels)
    return mosaic if better else part


def _part(
    boxes: tuple[NDArray[np.float64], NDArray[np.bool_]],
    sizes_px: NDArray[np.float64],
    image_size: tuple[int, int],
    network: InputSize,
) -> tuple[Part | None, float]:
    """Return the part of an image with everybody who is expected; None for the whole image.

    It is enlarged or shrunk so that people have the network's size in their geometric mean, as
    far as that costs no more than detection in the whole image. Also returned is the size of people
    in it to that wanted, at most 1.
    """
    inside, seen = boxes
    if not seen.any():
        return None, 1.0
    left, top = np.floor(inside[seen, :2].min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(inside[seen, 2:].max(axis=0)).astype(int).tolist()
    width, height = max(right - left, 1), max(bottom - top, 1)
    whole = network.long_side / max(image_size)
    most = whole * sqrt(image_size[0] * image_size[1] / (width * height))
    mean_px = float(np.exp(np.log(sizes_px[seen]).mean()))
    wanted = min(network.person_px / mean_px, LARGEST_SCALE)
    scale = min(wanted, most)
    side = ceil(scale * max(width, height) / network.multiple) * network.multiple
    if (width, height) == image_size and side >= network.long_side:
        return None, min(whole / wanted, 1.0)
    return Part(left, top, width, height, side), scale / wanted


def _input_pixels(part: Part | None, image_size: tuple[int, int], network: InputSize) -> int:
    part = part or Part(0, 0, *image_size, network.long_side)
    width, height = letterbox_to_side(part.size, part.long_side, network.multiple).input_size
    return width * height


def boxes_of(expected: ExpectedView, image_size: tuple[int, int]) -> NDArray[np.float64]:
    """Return where in an image people are expected, with margins.

    Args:
        expected: who is expected where.
        image_size: `(width, height)` in pixels.

    Returns:
        `(num_persons, 4)` left, top, right, bottom in pixels, of those who may be in the image.
    """
    inside, seen = _boxes(expected, image_size)
    return np.asarray(inside[seen])


def _boxes(
    expected: ExpectedView, image_size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return `(num_persons, 4)` boxes with margins, cut at the image, and which are in it."""
    points = expected.keypoints_px
    known = np.isfinite(points)
    low = np.where(known, points, np.inf).min(axis=1)
    high = np.where(known, points, -np.inf).max(axis=1)
    margin = MARGIN * (high - low).max(axis=1) + expected.reach_px
    with np.errstate(invalid="ignore"):
        boxes = np.concatenate([low - margin[:, None], high + margin[:, None]], axis=1)
    inside = np.clip(boxes, 0, np.array([*image_size, *image_size]))
    return inside, np.asarray((inside[:, 2:] > inside[:, :2]).all(axis=1))


def _sizes_px(expected: ExpectedView) -> NDArray[np.float64]:
    """Return `(num_persons,)` people's sizes, between the keypoints farthest apart."""
    points = expected.keypoints_px
    known = np.isfinite(points)
    low = np.where(known, points, np.inf).min(axis=1)
    high = np.where(known, points, -np.inf).max(axis=1)
    return np.asarray(np.maximum((high - low).max(axis=1), SMALLEST_PERSON_PX))
