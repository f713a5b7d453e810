"""How much people hide one another in every camera's view (paper section 3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig

Floats = NDArray[np.float64]

BOX_EXPANSION = 0.10  # paper section 3.2.1: a body is a little larger than its joints


def person_boxes(keypoints_px: Floats, image_size: tuple[int, int]) -> Floats:
    """Box every person in a view.

    Args:
        keypoints_px: `(*batch, num_joints, 2)` pixels; NaN where missing or behind the camera.
        image_size: `(width, height)` in pixels.

    Returns:
        `(*batch, 4)` left, top, right, bottom in pixels: the joints' box, made larger by
        `BOX_EXPANSION` about its centre and cut at the image border; NaN for people without a joint
        inside the image, who do not count in this view.
    """
    finite = np.asarray(np.isfinite(keypoints_px).all(axis=-1))[..., None]
    low = np.where(finite, keypoints_px, np.inf).min(axis=-2)
    high = np.where(finite, keypoints_px, -np.inf).max(axis=-2)
    size = np.array(image_size, dtype=np.float64)
    inside = np.asarray(inside_image(keypoints_px, image_size).any(axis=-1))
    with np.errstate(invalid="ignore"):
        margin = (high - low) * (BOX_EXPANSION / 2)
        low = np.clip(low - margin, -0.5, size - 0.5)
        high = np.clip(high + margin, -0.5, size - 0.5)
    boxes = np.concatenate([low, high], axis=-1)
    return np.where(inside[..., None], boxes, np.nan)


def inside_image(pixels: Floats, image_size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return `(*batch)`: whether pixels `(*batch, 2)` lie in the image; False for NaN."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels <= np.array(image_size) - 0.5)
    return np.asarray(inside.all(axis=-1))


def box_iou(first: Floats, second: Floats) -> Floats:
    """Return the intersection over union `(*batch)` of boxes `(*batch, 4)`; 0 if one is NaN."""
    with np.errstate(invalid="ignore", divide="ignore"):
        overlap = np.minimum(first[..., 2:], second[..., 2:]) - np.maximum(
            first[..., :2], second[..., :2]
        )
        intersection = np.clip(overlap, 0, None).prod(axis=-1)
        union = _area(first) + _area(second) - intersection
        iou = intersection / union
    return np.where(union > 0, iou, 0.0)


def occlusion(boxes: Floats) -> float:
    """Measure the occlusion in one view: the mean pairwise IoU of its boxes, paper eq. (4).

    Args:
        boxes: `(num_persons, 4)` left, top, right, bottom; NaN rows do not count.

    Returns:
        A number in [0, 1]; 0 when fewer than two people are in view.
    """
    present = boxes[np.isfinite(boxes).all(axis=-1)]
    first, second = np.triu_indices(len(present), k=1)
    if len(first) == 0:
        return 0.0
    return float(box_iou(present[first], present[second]).mean())


def expected_views(rig: Rig, joints_m: Floats) -> tuple[Floats, Floats]:
    """Foresee what every camera would see of people.

    Args:
        rig: the cameras.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.

    Returns:
        `(num_cameras,)` the occlusion of eq. (4), and `(num_cameras, num_persons)` the share of
        each person's joints inside the image.
    """
    hidden, inside = [], []
    for camera in rig.cameras:
        pixels = camera.project(joints_m)
        hidden.append(occlusion(person_boxes(pixels, camera.image_size)))
        inside.append(inside_image(pixels, camera.image_size).mean(axis=-1))
    return np.array(hidden), np.stack(inside)


def _area(boxes: Floats) -> Floats:
    extent = np.clip(boxes[..., 2:] - boxes[..., :2], 0, None)
    return np.asarray(extent[..., 0] * extent[..., 1])
