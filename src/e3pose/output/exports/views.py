"""Project 3D poses into the images of a rig."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton, convert
from e3pose.model.take import Take


def frames(take: Take, skeleton: Skeleton) -> list[tuple[int, People]]:
    """Return every slot of a take with its people in a skeleton, also those with nobody."""
    parts, slots = [], [np.zeros(0, dtype=np.int64)]
    for motion in take.motions:
        joints_m, scores = convert(motion.joints_m, motion.scores, take.skeleton, skeleton)
        rows = np.flatnonzero((scores > 0).any(axis=1))
        ids = np.full(len(rows), motion.track_id)
        parts.append(People(ids, joints_m[rows], scores[rows]))
        slots.append(motion.first + rows)
    people, numbers = People.joined(parts, len(skeleton)), np.concatenate(slots)
    order = np.argsort(numbers, kind="stable")
    shown = range(*take.span)
    starts = np.searchsorted(numbers[order], shown, side="left").tolist()
    ends = np.searchsorted(numbers[order], shown, side="right").tolist()
    return [
        (slot, people[order[low:high]]) for slot, low, high in zip(shown, starts, ends, strict=True)
    ]


def keypoints(people: People, camera: Camera) -> Floats:
    """Return `(num_people, num_joints, 3)` pixels and scores, 0 where missing or outside."""
    pixels = camera.project(people.joints_m)
    inside = ((pixels >= -0.5) & (pixels <= np.array(camera.image_size) - 0.5)).all(axis=-1)
    inside &= people.scores > 0
    together = np.concatenate([pixels, people.scores[..., None]], axis=-1)
    return np.where(inside[..., None], together, 0.0)
