"""Render a simulated recording as videos: detections drawn over a room."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image
from e3pose.detectors.drawn import LEVELS, draw
from e3pose.model.camera import Camera
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording

WALL, LINE = 24, 62  # greys
REACH_M = 4.0  # of the floor's squares of a metre
STEP_M = 0.25
LIKE_SHARE = 0.35  # of a height: how far a detection may be from the person it shows


def check_people(people: int) -> None:
    """Raise `InputError` for more people than differ in their shade."""
    if not 0 <= people <= len(LEVELS):
        raise InputError("films", f"{people} people", f"at most {len(LEVELS)}: --people 2")


def frames(recording: Recording, camera: int) -> Iterator[Image]:
    """Yield `(height, width, 3)` RGB, a frame per slot, of one camera's detections.

    Whoever the simulated detector missed is not drawn, nor are people whom it invented: a film
    shows the keypoints, errors included, of people who are there.

    Args:
        recording: a simulated one.
        camera: its index.

    Raises:
        InputError: for more people than differ in their shade, or another skeleton.
    """
    truth = recording.truth
    if truth is None or truth.skeleton != COCO17:
        raise InputError("films", "a recording without a truth in coco17", "a simulated one")
    check_people(len(truth.person_ids))
    lens = recording.rig.cameras[camera]
    empty = room(lens)
    for slot in range(recording.num_slots):
        joints_m = truth.joints_m[slot]
        places = lens.project(joints_m)  # (num_persons, 17, 2)
        depth = np.nan_to_num(((joints_m - lens.center_m) @ lens.R[2]).mean(axis=-1), nan=-1.0)
        view = recording.view(slot, camera) or Poses2D.empty(len(COCO17))
        places_px = np.where(depth[:, None, None] > 0, places, np.nan)
        # What was detected of each person, in their order; NaN where nothing was.
        shown = [np.full((len(COCO17), 2), np.nan) for _ in places_px]
        for detection in view.keypoints_px:
            off = np.linalg.norm(places_px - detection, axis=-1)
            known = np.isfinite(off)
            mean = np.where(known, off, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            height = np.nanmax(places_px[..., 1], axis=1, initial=0) - np.nanmin(
                places_px[..., 1], axis=1, initial=10**6
            )
            likely = np.where(known.sum(axis=1) >= 3, mean / np.maximum(height, 1.0), np.inf)
            if len(likely) and likely.min() < LIKE_SHARE:
                shown[int(likely.argmin())] = detection
        yield draw(empty, shown)


def room(camera: Camera) -> Image:
    """Return the picture of an empty room, which says that it is simulated."""
    import cv2

    width, height = camera.image_size
    image = np.full((height, width, 3), WALL, dtype=np.uint8)
    marks = np.arange(-REACH_M, REACH_M + 1e-9, 1.0)
    along = np.arange(-REACH_M, REACH_M + 1e-9, STEP_M)
    for mark in marks.tolist():
        for axis in (0, 1):
            points = np.zeros((len(along), 3))
            points[:, axis], points[:, 1 - axis] = mark, along
            ahead = (points - camera.center_m) @ camera.R[2] > 0.2
            pixels = camera.project(points)
            for a, b in zip(range(len(along) - 1), range(1, len(along)), strict=True):
                if ahead[a] and ahead[b] and np.abs(pixels[[a, b]]).max() < 10_000:
                    ends = (pixels[[a, b]] * 16).round().astype(int).tolist()
                    cv2.line(image, ends[0], ends[1], (LINE,) * 3, 1, cv2.LINE_AA, 4)
    scale = height / 700
    words = f"simulated: {camera.camera_id}"
    cv2.putText(
        image, words, (round(14 * scale), round(28 * scale)), cv2.FONT_HERSHEY_SIMPLEX,
        0.7 * scale, (150,) * 3, max(1, round(1.5 * scale)), cv2.LINE_AA,
    )  # fmt: skip
    return image
