"""How much people hide one another in every camera's view (paper section 3.2)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

BOX_EXPANSION = 0.10  # paper section 3.2.1: a body is a little larger than its joints


def person_boxes(keypoints_px: Floats, image_size: ArrayLike) -> Floats:
    """Box every person in a view.

    Args:
        keypoints_px: `(*batch, num_joints, 2)` pixels; NaN where missing or behind the camera.
        image_size: `(width, height)` in pixels, or `(*batch, 2)` of them.

    Returns:
        `(*batch, 4)` left, top, right, bottom in pixels: the joints' box, made larger by
        `BOX_EXPANSION` about its centre and cut at the image border; NaN for people without a joint
        inside the image, who do not count in this view.
    """
    finite = np.asarray(np.isfinite(keypoints_px).all(axis=-1))[..., None]
    low = np.where(finite, keypoints_px, np.inf).min(axis=-2)
    high = np.where(finite, keypoints_px, -np.inf).max(axis=-2)
    size = np.asarray(image_size, dtype=np.float64)
    inside = np.asarray(inside_image(keypoints_px, size[..., None, :]).any(axis=-1))
    with np.errstate(invalid="ignore"):
        margin = (high - low) * (BOX_EXPANSION / 2)
        low = np.minimum(np.maximum(low - margin, -0.5), size - 0.5)
        high = np.minimum(np.maximum(high + margin, -0.5), size - 0.5)
    boxes = np.concatenate([low, high], axis=-1)
    return np.where(inside[..., None], boxes, np.nan)


def inside_image(pixels: Floats, image_size: ArrayLike) -> NDArray[np.bool_]:
    """Return `(*batch)`: whether pixels `(*batch, 2)` lie in the image; False for NaN."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.asarray(image_size) - 0.5)
    return np.asarray(inside[..., 0] & inside[..., 1])


def box_iou(first: Floats, second: Floats) -> Floats:
    """Return the intersection over union `(*batch)` of boxes `(*batch, 4)`; 0 if one is NaN."""
    with np.errstate(invalid="ignore", divide="ignore"):
        overlap = np.minimum(first[..., 2:], second[..., 2:]) - np.maximum(
            first[..., :2], second[..., :2]
        )
        overlap = np.maximum(overlap, 0.0)
        intersection = overlap[..., 0] * overlap[..., 1]
        union = _area(first) + _area(second) - intersection
        iou = intersection / union
    return np.where(union > 0, iou, 0.0)


def occlusion(boxes: Floats) -> Floats:
    """Measure the occlusion in each view: the mean pairwise IoU of its boxes, paper eq. (4).

    Args:
        boxes: `(*batch, num_persons, 4)` left, top, right, bottom; NaN rows do not count.

    Returns:
        `(*batch)` numbers in [0, 1]; 0 where fewer than two people are in view.
    """
    first, second = _pairs(boxes.shape[-2])
    total = box_iou(boxes[..., first, :], boxes[..., second, :]).sum(axis=-1)
    present = np.isfinite(boxes).all(axis=-1).sum(axis=-1)
    return np.asarray(total / np.maximum(present * (present - 1) / 2, 1))


def expected_views(rig: Rig, joints_m: Floats) -> tuple[Floats, Floats]:
    """Foresee what every camera would see of people.

    Args:
        rig: the cameras.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.

    Returns:
        `(num_cameras,)` the occlusion of eq. (4), and `(num_cameras, num_persons)` the share of
        each person's joints inside the image.
    """
    sizes = np.array([camera.image_size for camera in rig.cameras])[:, None]
    pixels = np.stack([camera.project(joints_m) for camera in rig.cameras])
    inside = inside_image(pixels, sizes[:, None]).mean(axis=-1)
    return occlusion(person_boxes(pixels, sizes)), inside


@lru_cache(maxsize=64)
def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    first, second = np.triu_indices(count, k=1)
    return first, second


def _area(boxes: Floats) -> Floats:
    extent = np.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return np.asarray(extent[..., 0] * extent[..., 1])
