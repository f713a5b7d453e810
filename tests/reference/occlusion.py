"""Boxes of people and their overlap, in plain numpy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.base.arrays import Floats
from e3pose.select.occlusion import BOX_EXPANSION


def inside_image(pixels: Floats, image_size: ArrayLike) -> NDArray[np.bool_]:
    """Return `(*batch)`: whether pixels `(*batch, 2)` lie in the image; False for NaN."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.asarray(image_size) - 0.5)
    return np.asarray(inside[..., 0] & inside[..., 1])


def person_boxes(keypoints_px: Floats, image_size: ArrayLike) -> Floats:
    """See `e3pose.select.occlusion.person_boxes`."""
    size = np.asarray(image_size, dtype=np.float64)
    return _boxes(keypoints_px, inside_image(keypoints_px, size[..., None, :]), size)


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
    """See `e3pose.select.occlusion.box_iou`."""
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
    """See `e3pose.select.occlusion.occlusion`."""
    first, second = _pairs(boxes.shape[-2])
    total = box_iou(boxes[..., first, :], boxes[..., second, :]).sum(axis=-1)
    present = np.isfinite(boxes).all(axis=-1).sum(axis=-1)
    return np.asarray(total / np.maximum(present * (present - 1) / 2, 1))


@lru_cache(maxsize=64)
def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    first, second = np.triu_indices(count, k=1)
    return first, second


def _area(boxes: Floats) -> Floats:
    extent = np.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return np.asarray(extent[..., 0] * extent[..., 1])
