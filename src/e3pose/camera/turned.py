"""Detect in turned images, for cameras that are mounted on their side or upside down.

Networks find people who lie worse than people who stand. The image is turned for the detector alone
and what it finds is turned back, so that keypoints, calibration and videos stay in the pixels that
the camera delivers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.camera.orientation import Orientation
from e3pose.detectors.base import Detector, Image, check_image
from e3pose.detectors.focus import Focusing, InBoxes, Part
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D


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
