"""Occlusion of a view: mean IoU of its people's boxes (paper section 3.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.model.camera import Rig
from e3pose.model.project import Optics, make_optics, project_people

# tuned: s | by reasoning | by the truth of a day of `ring` half and twice: 0.6 and 0.5
#   % more error, as many missed; nothing forgotten as twice
SPREAD_MEMORY_S = 60.0  # a site's people come and go
BOX_EXPANSION = 0.10  # definition: paper section 3.2.1: a body is a little larger than its joints


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
    box_people(
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
    overlaps(
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
    occlude(views, found.reshape(-1))
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
    joints_m = np.array(joints_m, np.float64, order="C")  # of one type, for which it is compiled
    expect_boxes(_optics(rig), joints_m, occlusion, shares)
    return occlusion, shares


@lru_cache(maxsize=64)
def _optics(rig: Rig) -> Held[Optics]:
    return Held(make_optics(rig))


@kernel
def box_people(keypoints_px: Floats, sizes: Floats, boxes: Floats, shares: Floats) -> None:
    """Compute the boxes of all people.

    Args:
        keypoints_px: `(num_people, num_joints, 2)` pixels; NaN where missing.
        sizes: `(num_people, 2)` width and height of the image of each.
        boxes: `(num_people, 4)` filled, see `occlusion.person_boxes`.
        shares: `(num_people,)` filled with the share of the joints inside the image.
    """
    for person in range(len(boxes)):
        box, size = boxes[person], sizes[person]
        box[0] = box[1] = np.inf
        box[2] = box[3] = -np.inf
        inside = 0
        for joint in range(keypoints_px.shape[1]):
            x, y = keypoints_px[person, joint, 0], keypoints_px[person, joint, 1]
            if math.isfinite(x) and math.isfinite(y):
                inside += -0.5 <= x <= size[0] - 0.5 and -0.5 <= y <= size[1] - 0.5
                box[0], box[1] = min(box[0], x), min(box[1], y)
                box[2], box[3] = max(box[2], x), max(box[3], y)
        shares[person] = inside / max(keypoints_px.shape[1], 1)
        for axis in range(2):
            margin = (box[axis + 2] - box[axis]) * (BOX_EXPANSION / 2)
            most = size[axis] - 0.5
            box[axis] = min(max(box[axis] - margin, -0.5), most) if inside else np.nan
            box[axis + 2] = min(max(box[axis + 2] + margin, -0.5), most) if inside else np.nan


@kernel
def expect_boxes(rig: Held[Optics], joints_m: Floats, occlusion: Floats, shares: Floats) -> None:
    """Fill the expected views of every camera, see `occlusion.expected_views`.

    Args:
        rig: the cameras.
        joints_m: `(num_people, num_joints, 3)` metres, NaN where unknown.
        occlusion: `(num_cameras,)` filled.
        shares: `(num_cameras, num_people)` filled.
    """
    optics = rig.values
    num_cameras, num_people = shares.shape
    pixels = np.empty((*joints_m.shape[:2], 2))
    boxes, sizes = np.empty((num_cameras, num_people, 4)), np.empty((num_people, 2))
    for camera in range(num_cameras):
        for person in range(num_people):  # numba takes seconds to compile a row for all
            sizes[person, 0], sizes[person, 1] = optics.sizes[camera, 0], optics.sizes[camera, 1]
        project_people(camera, optics, joints_m, pixels)
        box_people(pixels, sizes, boxes[camera], shares[camera])
    occlude(boxes, occlusion)


@kernel
def overlap(first: Floats, second: Floats) -> float:
    """Return the intersection over union of two boxes `(4,)`; 0 if one is NaN."""
    width = max(min(first[2], second[2]) - max(first[0], second[0]), 0.0)
    height = max(min(first[3], second[3]) - max(first[1], second[1]), 0.0)
    union = _area(first) + _area(second) - width * height
    return width * height / union if union > 0 else 0.0


@kernel
def overlaps(first: Floats, second: Floats, found: Floats) -> None:
    """Fill `found` `(num_pairs,)` with the overlap of pairs of boxes `(num_pairs, 4)`."""
    for pair in range(len(found)):
        found[pair] = overlap(first[pair], second[pair])


@kernel
def occlude(boxes: Floats, occlusion: Floats) -> None:
    """Fill `occlusion` `(num_views,)` with paper eq. (4) of `boxes` `(num_views, num_people, 4)`.

    That is the mean overlap of pairs of boxes; those that are NaN do not count.
    """
    for view in range(len(boxes)):
        total, people = 0.0, 0
        for first in range(boxes.shape[1]):
            if not math.isnan(boxes[view, first, 0]):
                people += 1
                for second in range(first + 1, boxes.shape[1]):
                    total += overlap(boxes[view, first], boxes[view, second])
        occlusion[view] = total / max(people * (people - 1) / 2, 1.0)


@kernel
def _area(box: Floats) -> float:
    return float(max(box[2] - box[0], 0.0) * max(box[3] - box[1], 0.0))
