"""Boxes of people in views, and how much they overlap (paper section 3.2)."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.model.project import Optics, project_people

BOX_EXPANSION = 0.10  # definition: paper section 3.2.1: a body is a little larger than its joints


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
