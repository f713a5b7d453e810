"""Draw people as coloured dots, and detect them without a network, for tests and examples.

Every joint has a hue and every person a brightness, so that a dot says what it is. Films of them
go through the same cameras, codecs and clocks as those of real people; what they cannot show is how
a network errs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.focus import InParts, Part
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "drawn"
LEVELS = (255, 190, 130)  # brightness by person
HUES = 180  # of OpenCV
RADIUS_SHARE = 0.012  # of the image's height
LIMB_GREY = 70
SATURATED = 150  # of a dot; what is around it, and a limb, is grey
LEVEL_TOLERANCE = 32
LEAST_SHARE = 0.3  # of a dot that must be seen
SCORE = 0.8
FEWEST = 4  # joints of a person
FAR_PX = 10_000


class Drawn(InParts):
    """Finds the people that `draw` drew; at most three."""

    person_px, long_side, multiple = np.inf, 1, 1  # it reads the pixels as they are

    def __init__(self) -> None:
        self.skeleton = COCO17

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`; colours leave no ties."""
        import cv2

        size = check_image(image)
        colors = np.asarray(cv2.cvtColor(part.cut(image), cv2.COLOR_RGB2HSV))
        bright = cv2.inRange(colors, (0, SATURATED, LEVELS[-1] // 2 + 1), (HUES, 255, 255))
        # A codec mixes the colours along an edge.
        inside = cv2.findNonZero(cv2.erode(bright, np.ones((3, 3), dtype=np.uint8)))
        if inside is None:
            return Poses2D.empty(len(COCO17))
        columns, rows = np.asarray(inside).reshape(-1, 2).T
        hue, shade = colors[rows, columns, 0], colors[rows, columns, 2].astype(np.int64)
        away = np.abs(shade[:, None] - np.array(LEVELS))
        person = away.argmin(axis=1)
        step = HUES / len(COCO17)
        joint = np.round(hue / step).astype(np.int64) % len(COCO17)
        label = np.where(away.min(axis=1) <= LEVEL_TOLERANCE, person * len(COCO17) + joint, -1)
        keypoints, found = _centres(label, columns, rows, _radius(size[1]))
        found &= found.sum(axis=1, keepdims=True) >= FEWEST
        scores = np.where(found, SCORE, 0.0)
        return part.in_image(poses_in_image(keypoints, scores, part.size))


def draw(image: Image, people: Sequence[NDArray[np.float64]]) -> Image:
    """Return an image with people on it.

    Args:
        image: `(height, width, 3)` grey in RGB; stays as it is.
        people: at most three, each `(17, 2)` pixels in COCO-17, NaN where a joint is not to be
            seen; those in front come last.
    """
    import cv2

    drawn: Image = image.copy()
    radius = _radius(image.shape[0])
    for number, joints_px in enumerate(people[: len(LEVELS)]):
        with np.errstate(invalid="ignore"):
            seen = np.asarray((np.abs(joints_px) < FAR_PX).all(axis=-1))
        ends = np.where(seen[:, None], joints_px * 16, 0).round().astype(np.int64).tolist()
        for a, b in COCO17.limbs:
            if seen[a] and seen[b]:
                cv2.line(drawn, ends[a], ends[b], (LIMB_GREY,) * 3, radius // 2, cv2.LINE_AA, 4)
        for joint in np.flatnonzero(seen).tolist():
            hue = round(joint * HUES / len(COCO17)) % HUES
            pixel = np.array([[[hue, 255, LEVELS[number]]]], dtype=np.uint8)
            color = cv2.cvtColor(pixel, cv2.COLOR_HSV2RGB)[0, 0].tolist()
            cv2.circle(drawn, ends[joint], radius * 16, color, -1, cv2.LINE_AA, 4)
    return drawn


def _radius(height: int) -> int:
    return max(4, round(height * RADIUS_SHARE))


def _centres(
    label: NDArray[np.int64], columns: NDArray[np.int64], rows: NDArray[np.int64], radius: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return `(3, 17, 2)` medians of the pixels of every dot, and `(3, 17)` which are there."""
    shape = (len(LEVELS), len(COCO17))
    keypoints, found = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=bool)
    order = np.argsort(label, kind="stable")
    labels, starts = np.unique(label[order], return_index=True)
    for one, pixels in zip(labels.tolist(), np.split(order, starts[1:]), strict=True):
        if one < 0 or len(pixels) < LEAST_SHARE * np.pi * radius**2:
            continue
        x, y = columns[pixels], rows[pixels]
        middle = np.array([np.median(x), np.median(y)])
        near = np.hypot(x - middle[0], y - middle[1]) <= 2 * radius  # of this dot, not of an edge
        if near.any():
            person, joint = divmod(one, len(COCO17))
            keypoints[person, joint] = x[near].mean(), y[near].mean()
            found[person, joint] = True
    return keypoints, found
