"""Rotate images by quarter turns: by the display matrix of a video, or as a camera is mounted.

A phone films with its sensor lying and writes into the file how to hold the picture. Players obey,
so a calibration made from what a player showed is of the turned picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.detectors.base import Detector, Image, check_image
from e3pose.detectors.focus import Focusing, InBoxes, Part
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D


@dataclass(frozen=True, slots=True)
class Orientation:
    """The turn from a decoded picture to the shown one: transpose first, then mirror.

    Attributes:
        transpose: whether rows become columns.
        flip_x: whether the result is mirrored left to right.
        flip_y: whether the result is mirrored top to bottom.
    """

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @classmethod
    def from_matrix(cls, matrix: NDArray[np.int32], where: str) -> Orientation:
        """Read a display matrix: shown (x, y) = decoded (x, y) @ [[a, b], [c, d]] in 16.16.

        Args:
            matrix: `(9,)` a b u, c d v, x y w.
            where: the file, for the message.

        Raises:
            InputError: when the matrix turns by anything but a multiple of 90 degrees.
        """
        (a, b), (c, d) = (np.asarray(matrix, dtype=np.float64).reshape(3, 3)[:2, :2] / 65536).round(
            3
        )
        if b == c == 0 and abs(a) == abs(d) > 0:
            return cls(False, bool(a < 0), bool(d < 0))
        if a == d == 0 and abs(b) == abs(c) > 0:
            return cls(True, bool(c < 0), bool(b < 0))
        raise InputError(
            f"{where}: display matrix: found {a:g} {b:g}, {c:g} {d:g}, "
            "expected a rotation by a multiple of 90 degrees (--as-stored ignores it)"
        )

    @classmethod
    def from_degrees(cls, degrees: int) -> Orientation:
        """Return the rotation by 0, 90, 180 or 270 degrees clockwise."""
        return cls(degrees in (90, 270), degrees in (90, 180), degrees in (180, 270))

    def apply(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the `(height, width, 3)` image as it is to be shown."""
        if self.transpose:
            image = image.swapaxes(0, 1)
        rows = slice(None, None, -1 if self.flip_y else 1)
        columns = slice(None, None, -1 if self.flip_x else 1)
        return np.ascontiguousarray(image[rows, columns])

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return `(width, height)` of the shown image."""
        return (height, width) if self.transpose else (width, height)

    def points(self, points_px: Floats, width: int, height: int) -> Floats:
        """Return points of the decoded image as those of the shown one.

        Args:
            points_px: `(*batch, 2)` pixels; (0, 0) is the centre of the top-left one.
            width: of the decoded image, pixels.
            height: of the decoded image, pixels.
        """
        points_px = points_px[..., ::-1] if self.transpose else points_px
        return self._mirrored(points_px, width, height)

    def points_back(self, points_px: Floats, width: int, height: int) -> Floats:
        """Return points of the shown image as those of the decoded one, see `points`."""
        points_px = self._mirrored(points_px, width, height)
        return points_px[..., ::-1] if self.transpose else points_px

    def _mirrored(self, points_px: Floats, width: int, height: int) -> Floats:
        last_px = np.array(self.size(width, height)) - 1.0
        return np.where((self.flip_x, self.flip_y), last_px - points_px, points_px)


def display_orientation(side_data: Mapping[Any, Any], where: str) -> Orientation:
    """Return the orientation that a picture's side data asks for; upright if it asks nothing."""
    # By name: what iterating side data gives, its items or their kinds, depends on PyAV's version.
    matrix = side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return Orientation()
    return Orientation.from_matrix(np.frombuffer(bytes(matrix), dtype=np.int32)[:9], where)


# Detect in turned images, for cameras that are mounted on their side or upside down.
#
# Networks find people who lie worse than people who stand. The image is turned for the detector
# alone and what it finds is turned back, so that keypoints, calibration and videos stay in the
# pixels that the camera delivers.


def turned(detector: Detector, degrees: int) -> Detector:
    """Return a detector for rotated images, with the feedback that it can use.

    Args:
        detector: finds people who are upright.
        degrees: 0, 90, 180 or 270 clockwise, by which images are turned so that people are upright.
    """
    if degrees == 0:
        return detector
    orientation = Orientation.from_degrees(degrees)
    if isinstance(detector, InBoxes):
        return TurnedInBoxes(detector, orientation)
    if isinstance(detector, Focusing):
        return TurnedFocusing(detector, orientation)
    return Turned(detector, orientation)


class Turned:
    """A detector behind an orientation; keypoints are in pixels of the image as it is given."""

    def __init__(self, detector: Detector, orientation: Orientation) -> None:
        self.skeleton = detector.skeleton
        self.provider = getattr(detector, "provider", "")
        self.threads = getattr(detector, "threads", None)
        self.orientation = orientation
        self._whole = detector

    def detect(self, image: Image) -> Poses2D:
        """See `Detector.detect`."""
        check_image(image)
        return self._back(self._whole.detect(self.orientation.apply(image)), image)

    def _back(self, poses: Poses2D, image: Image) -> Poses2D:
        """Return poses in pixels of the turned image as those of the image."""
        found_px = self.orientation.points_back(poses.keypoints_px, *check_image(image))
        return Poses2D(found_px, poses.scores)


class TurnedFocusing(Turned):
    """The same for a detector that can detect in a part of an image."""

    def __init__(self, detector: Focusing, orientation: Orientation) -> None:
        super().__init__(detector, orientation)  # type: ignore[arg-type]
        self.person_px, self.long_side = detector.person_px, detector.long_side
        self.multiple = detector.multiple
        self.free_input = getattr(detector, "free_input", False)
        self._parts = detector

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`."""
        width, height = check_image(image)
        right, bottom = part.left + part.width, part.top + part.height
        box = np.array([[part.left, part.top, right, bottom]], dtype=np.float64)
        corners = turned_boxes(self.orientation, box, width, height)[0]
        left, top, right, bottom = corners.round().astype(int).tolist()
        turned_part = Part(left, top, right - left, bottom - top, part.long_side)
        if expected is not None:
            points_px = self.orientation.points(expected.keypoints_px, width, height)
            expected = ExpectedView(points_px, expected.reach_px)
        found = self._parts.detect_part(self.orientation.apply(image), turned_part, expected)
        return self._back(found, image)


class TurnedInBoxes(Turned):
    """The same of a detector that finds one person at a time, in a box around each."""

    def __init__(self, detector: InBoxes, orientation: Orientation) -> None:
        super().__init__(detector, orientation)  # type: ignore[arg-type]
        self._boxes = detector

    def detect_in_boxes(self, image: Image, boxes: NDArray[np.float64]) -> Poses2D:
        """See `InBoxes.detect_in_boxes`."""
        there = turned_boxes(self.orientation, boxes, *check_image(image))
        return self._back(self._boxes.detect_in_boxes(self.orientation.apply(image), there), image)


def turned_boxes(
    orientation: Orientation, boxes: NDArray[np.float64], width: int, height: int
) -> NDArray[np.float64]:
    """Return boxes of an image as those of the turned one.

    Args:
        orientation: by which it is turned.
        boxes: `(num_boxes, 4)` left, top, right, bottom, from the outer edge of the first pixel.
        width: of the image, pixels.
        height: of the image, pixels.
    """
    # Outer edges lie half a pixel from the centres that `points` counts from.
    corners = orientation.points(boxes.reshape(-1, 2, 2) - 0.5, width, height) + 0.5
    return np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=-1)
