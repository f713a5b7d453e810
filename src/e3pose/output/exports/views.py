"""Project 3D poses into the images of a rig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera
from e3pose.model.skeleton import Skeleton, convert
from e3pose.model.take import Take


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Everybody in one frame, in one skeleton.

    Attributes:
        slot: the frame.
        track_ids: `(num_people,)`.
        joints_m: `(num_people, num_joints, 3)` world metres, NaN where missing.
        scores: `(num_people, num_joints)` in [0, 1], 0 where missing.
    """

    slot: int
    track_ids: NDArray[np.int64]
    joints_m: Floats
    scores: Floats


def frames(take: Take, skeleton: Skeleton) -> list[Frame]:
    """Return every frame of a take, also those with nobody, converted to a skeleton."""
    first, stop = take.span
    rows: list[list[tuple[int, Floats, Floats]]] = [[] for _ in range(stop - first)]
    for motion in take.motions:
        joints_m, scores = convert(motion.joints_m, motion.scores, take.skeleton, skeleton)
        for row in np.flatnonzero((scores > 0).any(axis=1)).tolist():
            place = motion.first - first + row
            rows[place].append((motion.track_id, joints_m[row], scores[row]))
    found = []
    for number, people in enumerate(rows):
        joints = np.array([joints for _, joints, _ in people]).reshape(-1, len(skeleton), 3)
        found.append(
            Frame(
                first + number,
                np.array([track_id for track_id, _, _ in people], dtype=np.int64),
                joints,
                np.array([scores for _, _, scores in people]).reshape(-1, len(skeleton)),
            )
        )
    return found


def keypoints(frame: Frame, camera: Camera) -> Floats:
    """Return `(num_people, num_joints, 3)` pixels and scores, 0 where missing or outside."""
    pixels = camera.project(frame.joints_m)
    inside = ((pixels >= -0.5) & (pixels <= np.array(camera.image_size) - 0.5)).all(axis=-1)
    inside &= frame.scores > 0
    together = np.concatenate([pixels, frame.scores[..., None]], axis=-1)
    return np.where(inside[..., None], together, 0.0)
