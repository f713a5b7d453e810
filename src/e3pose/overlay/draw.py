"""Draw skeletons on an image."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Camera
from e3pose.pose import Poses2D, Poses3D
from e3pose.skeleton import Skeleton

Image = NDArray[np.uint8]
Color = tuple[int, int, int]

GOLDEN_TURN = 0.618034  # neighbouring track ids get far-apart hues
SUBPIXEL_BITS = 4  # OpenCV draws lines between sixteenths of a pixel
MAX_DRAWN_PX = 20_000  # beyond, OpenCV's fixed-point coordinates overflow
OUTLINE: Color = (0, 0, 0)


def track_color(track_id: int) -> Color:
    """Return the RGB colour of a track: always the same, and unlike those of its neighbours."""
    red, green, blue = colorsys.hsv_to_rgb((track_id * GOLDEN_TURN + 0.02) % 1.0, 0.85, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


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


def reproject(poses: Poses3D, camera: Camera) -> Poses2D:
    """Return where a camera sees 3D poses; joints behind it are missing."""
    if not len(poses):
        return Poses2D.empty(poses.scores.shape[1])
    return Poses2D(camera.project(poses.joints_m), poses.scores)
