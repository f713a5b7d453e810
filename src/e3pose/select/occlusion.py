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
    size = np.asarray(image_size, dtype=np.float64)
    return _boxes(keypoints_px, inside_image(keypoints_px, size[..., None, :]), size)


def inside_image(pixels: Floats, image_size: ArrayLike) -> NDArray[np.bool_]:
    """Return `(*batch)`: whether pixels `(*batch, 2)` lie in the image; False for NaN."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.asarray(image_size) - 0.5)
    return np.asarray(inside[..., 0] & inside[..., 1])


def _boxes(keypoints_px: Floats, inside: NDArray[np.bool_], size: Floats) -> Floats:
    """Box people whose joints `(*batch, num_joints)` are `inside` the image or not."""
    x, y = keypoints_px[..., 0], keypoints_px[..., 1]
    finite = np.isfinite(x) & np.isfinite(y)
    boxes = np.empty((*keypoints_px.shape[:-2], 4))
    for axis, along in enumerate((x, y)):
        low = np.where(finite, along, np.inf).min(axis=-1, initial=np.inf)
        high = np.where(finite, along, -np.inf).max(axis=-1, initial=-np.inf)
        with np.errstate(invalid="ignore"):
            margin = (high - low) * (BOX_EXPANSION / 2)
            most = size[..., axis] - 0.5
            boxes[..., axis] = np.clip(low - margin, -0.5, most)
            boxes[..., axis + 2] = np.clip(high + margin, -0.5, most)
    boxes[~inside.any(axis=-1)] = np.nan
    return boxes


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
    pixels = rig.project(joints_m)
    sizes = rig.image_sizes[:, None]
    inside = inside_image(pixels, sizes[:, None])
    share = inside.mean(axis=-1) if pixels.shape[2] else np.zeros(pixels.shape[:2])
    return occlusion(_boxes(pixels, inside, sizes)), share


@lru_cache(maxsize=64)
def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    first, second = np.triu_indices(count, k=1)
    return first, second


def _area(boxes: Floats) -> Floats:
    extent = np.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return np.asarray(extent[..., 0] * extent[..., 1])
