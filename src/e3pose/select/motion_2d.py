"""2D motion vectors of boxes: the prediction of a camera by itself (paper's ID baseline).

The paper's ID baseline and the centrally controlled alternative of its timeline figure decide from
this, and from nothing that other cameras saw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.select.occlusion import box_iou, occlusion, person_boxes


@dataclass(frozen=True, slots=True, eq=False)
class LastView:
    """The last view of a camera.

    Attributes:
        slot: when it was last active; -1 if never.
        boxes: `(num_persons, 4)` what it saw then, left, top, right, bottom in pixels.
        motion: `(num_persons, 4)` pixels per slot, from its two newest views; 0 for newcomers.
    """

    slot: int
    boxes: Floats
    motion: Floats

    @classmethod
    def none(cls) -> LastView:
        """Return that of a camera without a view."""
        return cls(-1, np.zeros((0, 4)), np.zeros((0, 4)))

    def at(self, slot: int) -> LastView:
        """Return the last view of an active camera; its boxes are not needed."""
        return LastView(slot, self.boxes, self.motion)


def with_view(last: LastView, view: Poses2D, slot: int, image_size: tuple[int, int]) -> LastView:
    """Return the last view after a camera detected `view` in `slot`."""
    boxes = person_boxes(view.keypoints_px, image_size)
    boxes = boxes[np.isfinite(boxes).all(axis=-1)]
    motion = np.zeros_like(boxes)
    if last.slot >= 0 and len(last.boxes) and len(boxes):
        elapsed = slot - last.slot
        similarity = box_iou(last.boxes[:, None], boxes[None])
        while similarity.max() > 0:  # greedily, the best overlap first
            old, new = np.unravel_index(np.argmax(similarity), similarity.shape)
            motion[new] = (boxes[new] - last.boxes[old]) / elapsed
            similarity[old, :] = 0
            similarity[:, new] = 0
    return LastView(slot, boxes, motion)


def with_views(
    last_views: Sequence[LastView], views: Mapping[int, Poses2D], slot: int, rig: Rig | None
) -> tuple[LastView, ...]:
    """Return the last views after `slot`, by camera; without a rig their boxes are not needed."""
    if rig is None:
        return tuple(s.at(slot) if index in views else s for index, s in enumerate(last_views))
    return tuple(
        with_view(last, views[index], slot, camera.image_size) if index in views else last
        for index, (last, camera) in enumerate(zip(last_views, rig.cameras, strict=True))
    )


def last_slots(last_views: Sequence[LastView], ordered: Flags, slot: int) -> Integers:
    """Return `(num_cameras,)`: the slot of each camera's last detection, ordered ones included.

    Args:
        last_views: by camera.
        ordered: `(num_slots, num_cameras)` detections to come.
        slot: of its first row.
    """
    newest = [last.slot for last in last_views]
    for number, cameras in enumerate(ordered.tolist(), start=slot):
        newest = [number if active else last for active, last in zip(cameras, newest, strict=True)]
    return np.array(newest, dtype=np.int64)


def own_occlusion(last_views: Sequence[LastView], slot: int, rig: Rig) -> Floats:
    """Return `(num_cameras,)`: the occlusion, eq. (4), that each camera itself expects in `slot`.

    Boxes that have left the image by then do not count, nor do their parts outside it; NaN for a
    camera without a view.
    """
    slots = np.array([last.slot for last in last_views])
    boxes = np.full(
        (len(last_views), max((len(last.boxes) for last in last_views), default=0), 4), np.nan
    )
    for row, last in zip(boxes, last_views, strict=True):
        row[: len(last.boxes)] = last.boxes + (slot - last.slot) * last.motion
    sizes = np.tile(rig.image_sizes, 2)
    with np.errstate(invalid="ignore"):
        boxes = np.minimum(np.maximum(boxes, -0.5), sizes[:, None] - 0.5)
        in_view = (boxes[..., 2:] > boxes[..., :2]).all(axis=-1)
    return np.where(slots < 0, np.nan, occlusion(np.where(in_view[..., None], boxes, np.nan)))
