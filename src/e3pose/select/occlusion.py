"""Occlusion of a view: mean IoU of its people's boxes (paper section 3.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Floats
from e3pose.base.kernel_arguments import Held
from e3pose.model.camera import Rig
from e3pose.model.project import Optics, make_optics
from e3pose.select.kernels import boxes as kernels

# tuned: s | by reasoning | not measured
SPREAD_MEMORY_S = 60.0  # a site's people come and go


@dataclass(frozen=True, slots=True)
class Spread:
    """Spread of the cameras' occlusion in a slot: the unit of the paper's V.

    IoU is small where there are many people or large rooms and large where they crowd, so that a
    weight on it means something else at every site. Divided by this it does not.

    Attributes:
        mean: standard deviation of the occlusion over cameras, the mean over slots; 0 at first.
        slots: over how many slots, those left out in which nobody hides anybody anywhere.
    """

    mean: float = 0.0
    slots: int = 0

    def after(self, occlusion: Floats, interval_s: float) -> Spread:
        """Return the spread after a slot with `occlusion` `(num_cameras,)` of eq. (4)."""
        values = occlusion.tolist()
        if len(values) < 2 or not any(values):
            return self
        share = max(1 / (self.slots + 1), min(1.0, interval_s / SPREAD_MEMORY_S))
        centre = sum(values) / len(values)  # of a handful: NumPy takes ten times as long
        variance = sum([(value - centre) ** 2 for value in values]) / len(values)
        mean = self.mean + share * (math.sqrt(variance) - self.mean)
        return Spread(mean, self.slots + 1)


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
    batch = keypoints_px.shape[:-2]
    return _boxes(keypoints_px, np.broadcast_to(image_size, (*batch, 2)))[0]


def _boxes(keypoints_px: Floats, sizes: Floats) -> tuple[Floats, Floats]:
    """Return the boxes `(*batch, 4)` and the shares `(*batch)` of the joints inside the image."""
    batch = keypoints_px.shape[:-2]
    boxes, shares = np.empty((*batch, 4)), np.empty(batch)
    kernels.box_people(
        np.ascontiguousarray(keypoints_px, dtype=np.float64).reshape(-1, *keypoints_px.shape[-2:]),
        np.ascontiguousarray(sizes, dtype=np.float64).reshape(-1, 2),
        boxes.reshape(-1, 4),
        shares.reshape(-1),
    )
    return boxes, shares


def box_iou(first: Floats, second: Floats) -> Floats:
    """Return the intersection over union `(*batch)` of boxes `(*batch, 4)`; 0 if one is NaN."""
    first, second = np.broadcast_arrays(first, second)
    iou = np.empty(first.shape[:-1])
    kernels.overlaps(
        np.ascontiguousarray(first).reshape(-1, 4),
        np.ascontiguousarray(second).reshape(-1, 4),
        iou.reshape(-1),
    )
    return iou


def occlusion(boxes: Floats) -> Floats:
    """Measure the occlusion in each view: the mean pairwise IoU of its boxes, paper eq. (4).

    Args:
        boxes: `(*batch, num_persons, 4)` left, top, right, bottom; NaN rows do not count.

    Returns:
        `(*batch)` numbers in [0, 1]; 0 where fewer than two people are in view.
    """
    found = np.empty(boxes.shape[:-2])
    views = np.ascontiguousarray(boxes).reshape(found.size, *boxes.shape[-2:])
    kernels.occlude(views, found.reshape(-1))
    return found


def expected_views(rig: Rig, joints_m: Floats) -> tuple[Floats, Floats]:
    """Predict the views of every camera: joints projected, paper eq. (7), and boxes around them.

    Args:
        rig: the cameras.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.

    Returns:
        `(num_cameras,)` the occlusion of eq. (4), and `(num_cameras, num_persons)` the share of
        each person's joints inside the image.
    """
    occlusion, shares = np.empty(len(rig)), np.empty((len(rig), len(joints_m)))
    kernels.expect_boxes(_optics(rig), np.ascontiguousarray(joints_m), occlusion, shares)
    return occlusion, shares


@lru_cache(maxsize=64)
def _optics(rig: Rig) -> Held[Optics]:
    return Held(make_optics(rig))
