"""The Protocol of a detector: one image in, 2D poses out."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton

Image = NDArray[np.uint8]

MAX_IMAGE_SIDE = 16_384  # pixels; larger is a broken header, not a camera


class Detector(Protocol):
    """Finds people in images; `skeleton` is the joint axis of the poses it returns.

    One that has `threads`, the CPU threads of a look, may be called from several threads at once.
    One that has `content_size(image_size)` -> `(width, height)` gets frames of films in that size,
    where it is the smaller one, and returns pixels of it.
    """

    skeleton: Skeleton

    def detect(self, image: Image) -> Poses2D:
        """Return the people in `image`.

        Args:
            image: `(height, width, 3)` RGB.

        Returns:
            Poses in pixels of `image`, where (0, 0) is the centre of the top-left pixel.

        Raises:
            InputError: when `image` is no such array.
        """
        ...


def check_image(image: Image) -> tuple[int, int]:
    """Return `(width, height)` of an RGB image; raise `InputError` if it is not one."""
    shape, dtype = np.shape(image), getattr(image, "dtype", None)
    if len(shape) != 3 or shape[2] != 3 or dtype != np.uint8:
        raise InputError(
            f"image: found shape {shape} of {dtype}, expected (height, width, 3) RGB of uint8"
        )
    if not all(1 <= side <= MAX_IMAGE_SIDE for side in shape[:2]):
        raise InputError(
            f"image: found {shape[1]}x{shape[0]} pixels, expected sides of 1 to {MAX_IMAGE_SIDE}"
        )
    return shape[1], shape[0]


def poses_in_image(
    keypoints_px: NDArray[Any],
    scores: NDArray[Any],
    image_size: tuple[int, int],
    min_score: float = 0.0,
) -> Poses2D:
    """Make a view of a network's output, less the keypoints below the least score.

    Networks place keypoints of cut-off people beyond the border and score a little above 1 or below
    0; such keypoints are dropped and such scores clipped.

    Args:
        keypoints_px: `(num_persons, num_joints, 2)` pixels of the image.
        scores: `(num_persons, num_joints)`.
        image_size: `(width, height)` in pixels.
        min_score: keypoints scored less are missing.

    Returns:
        The people with at least one keypoint left.
    """
    keypoints_px = np.asarray(keypoints_px, dtype=np.float64)
    scores = np.nan_to_num(np.asarray(scores, dtype=np.float64), nan=0.0)
    with np.errstate(invalid="ignore"):
        inside = (keypoints_px >= -0.5) & (keypoints_px <= np.asarray(image_size) - 0.5)
    kept = inside.all(axis=-1) & (scores >= min_score) & (scores > 0)
    scores = np.where(kept, np.clip(scores, 0.0, 1.0), 0.0)
    seen = kept.any(axis=-1)
    return Poses2D(np.where(kept[..., None], keypoints_px, np.nan)[seen], scores[seen])
