"""Draw skeletons on an image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.model.camera import Camera
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton

Image = NDArray[np.uint8]
Color = tuple[int, int, int]

# Distinct with any colour vision (after Okabe and Ito), bright enough for dim pictures, and in
# the order of the report's, so that a person has much the same colour in both.
TRACK_COLORS: tuple[Color, ...] = (
    (60, 150, 255), (255, 115, 25), (0, 225, 150), (255, 140, 205),
    (130, 220, 255), (255, 205, 40), (215, 215, 215), (190, 120, 70),
)  # fmt: skip
SUBPIXEL_BITS = 4  # OpenCV draws lines between sixteenths of a pixel
MAX_DRAWN_PX = 20_000  # beyond, OpenCV's fixed-point coordinates overflow
OUTLINE: Color = (0, 0, 0)


def track_color(track_id: int) -> Color:
    """Return the RGB colour of a track: always the same, and unlike those of its neighbours."""
    return TRACK_COLORS[track_id % len(TRACK_COLORS)]


def draw_poses(
    image: Image,
    poses: Poses2D,
    skeleton: Skeleton,
    colors: Sequence[Color],
    thickness_px: int | None = None,
) -> Image:
    """Return the image with skeletons drawn on it.

    Args:
        image: `(height, width, 3)` RGB; stays as it is.
        poses: pixels of that image; what is missing is not drawn.
        skeleton: the convention of the poses.
        colors: RGB, one per person.
        thickness_px: of a limb; by default it follows the image's height.
    """
    import cv2

    drawn: Image = image.copy()
    width = thickness_px or max(1, round(image.shape[0] / 240))
    scale = 1 << SUBPIXEL_BITS
    for joints_px, color in zip(poses.keypoints_px, colors, strict=True):
        with np.errstate(invalid="ignore"):
            seen = (np.abs(joints_px) < MAX_DRAWN_PX).all(axis=-1)
        ends = np.where(seen[:, None], joints_px * scale, 0).round().astype(np.int64).tolist()
        limbs = [(a, b) for a, b in skeleton.limbs if seen[a] and seen[b]]
        # The dark outline first, so that a skeleton stands out from clothes of its colour.
        for paint, extra in ((OUTLINE, 2), (color, 0)):
            for a, b in limbs:
                cv2.line(drawn, ends[a], ends[b], paint, width + extra, cv2.LINE_AA, SUBPIXEL_BITS)
            for joint in np.flatnonzero(seen):
                radius = (width + 1 + extra // 2) * scale
                cv2.circle(drawn, ends[joint], radius, paint, -1, cv2.LINE_AA, SUBPIXEL_BITS)
    return drawn


def reproject(people: People, camera: Camera) -> Poses2D:
    """Return where a camera sees people; joints behind it are missing."""
    if not len(people):
        return Poses2D.empty(people.scores.shape[1])
    return Poses2D(camera.project(people.joints_m), people.scores)
