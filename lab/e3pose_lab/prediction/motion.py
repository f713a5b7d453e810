"""Motion for evaluating predictors: truth, or tracks estimated from all cameras."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal
from zlib import crc32

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.model.skeleton import MEANS, Skeleton
from e3pose.recording import Recording, Truth
from e3pose.simulate.noise import correlated

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord


LIMB_JOINTS = tuple(
    f"{side}_{joint}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
)
BODY_JOINTS = (*LIMB_JOINTS, "neck", "head")
HIPS = (LIMB_JOINTS.index("left_hip"), LIMB_JOINTS.index("right_hip"))
# The first of these that a skeleton has stands for the joint; a mean of others is tried last.
STAND_INS = {"neck": ("neck", "bottom_head"), "head": ("nose", "top_head")}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """People moving, each for as long as they were there.

    Attributes:
        name: of the recording.
        source: `truth`, or `estimates` where the recording has none.
        skeleton: the convention of the joints.
        rig: the cameras that people are boxed in.
        interval_s: seconds per slot.
        people: per person `(num_slots, num_joints, 3)` metres, NaN where unknown.
    """

    name: str
    source: Literal["truth", "estimates"]
    skeleton: Skeleton
    rig: Rig
    interval_s: float
    people: tuple[Floats, ...]


def true_motion(recording: Recording, truth: Truth) -> Motion:
    """Return the motion of the truth, every person from their first slot to their last."""
    people = []
    for joints_m in np.moveaxis(truth.joints_m, 1, 0):
        there = np.flatnonzero(np.isfinite(joints_m).all(axis=-1).any(axis=-1))
        if len(there):
            people.append(joints_m[there[0] : there[-1] + 1])
    return Motion(
        recording.name,
        "truth",
        truth.skeleton,
        recording.rig,
        recording.interval_s,
        tuple(people),
    )


def estimated_motion(recording: Recording, records: Iterable[SlotRecord]) -> Motion:
    """Return the motion of the tracks of a replay, one person per track id."""
    slots: dict[int, list[int]] = {}
    poses: dict[int, list[Floats]] = {}
    for record in records:
        for track, joints_m in zip(
            record.people.track_ids.tolist(), record.people.joints_m, strict=True
        ):
            slots.setdefault(track, []).append(record.slot)
            poses.setdefault(track, []).append(joints_m)
    people = []
    for track, seen in slots.items():
        joints = np.full((seen[-1] - seen[0] + 1, len(recording.skeleton), 3), np.nan)
        joints[np.array(seen) - seen[0]] = poses[track]
        people.append(joints)
    return Motion(
        recording.name,
        "estimates",
        recording.skeleton,
        recording.rig,
        recording.interval_s,
        tuple(people),
    )


def disturbed(motion: Motion, noise_m: float, missing: float, seed: int) -> tuple[Floats, ...]:
    """Return the people of a motion as an estimator would give them.

    Every coordinate gets normal noise with the memory that was measured on real detections
    (`ErrorMemory`), and joints go missing, each in each slot by itself.

    Args:
        motion: exact.
        noise_m: standard deviation of the noise in each coordinate, metres.
        missing: share of the joints that go missing, [0, 1].
        seed: the same for the same noise.
    """
    people = []
    for person, joints_m in enumerate(motion.people):
        rng = np.random.default_rng([seed, crc32(motion.name.encode()), person])
        noise = noise_m * correlated(rng, joints_m.shape, motion.interval_s, ErrorMemory().parts)
        lost = rng.random(joints_m.shape[:-1]) < missing
        people.append(np.where(lost[..., None], np.nan, joints_m + noise))
    return tuple(people)


def body_joints(joints_m: Floats, skeleton: Skeleton) -> Floats:
    """Return `(*batch, 14, 3)`: `BODY_JOINTS` of poses of any skeleton, NaN where unknown.

    The neck is the neck or the bottom of the head, or the middle of the shoulders where a skeleton
    has neither. The head is the nose, or its top where a skeleton has no nose.
    """
    columns = _columns(skeleton)
    body = np.full((*joints_m.shape[:-2], len(BODY_JOINTS), 3), np.nan)
    for index, joint in enumerate(BODY_JOINTS):
        if columns[joint]:
            body[..., index, :] = joints_m[..., columns[joint], :].mean(axis=-2)
    return body


def body_errors(error_m: Floats, skeleton: Skeleton) -> Floats:
    """Return `(*batch, 14)` expected errors of `BODY_JOINTS`; NaN where a joint is a mean."""
    columns = _columns(skeleton)
    body = np.full((*error_m.shape[:-1], len(BODY_JOINTS)), np.nan)
    for index, joint in enumerate(BODY_JOINTS):
        if len(columns[joint]) == 1:
            body[..., index] = error_m[..., columns[joint][0]]
    return body


def _columns(skeleton: Skeleton) -> Mapping[str, Sequence[int]]:
    """Return where each of `BODY_JOINTS` stands in a skeleton: one index, several to average."""
    columns: dict[str, Sequence[int]] = {}
    for joint in BODY_JOINTS:
        singles = [(name,) for name in STAND_INS.get(joint, (joint,))]
        choices = (*singles, *((MEANS[joint],) if joint in MEANS else ()))
        fitting = [names for names in choices if set(names) <= set(skeleton.joints)]
        columns[joint] = [skeleton.index(name) for name in fitting[0]] if fitting else []
    return columns
