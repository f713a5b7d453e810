"""Add feet to a simulated recording: keypoints that COCO-17 lacks.

Feet are rigid and flat, and point where the hips face. A camera sees the joints of a foot where it
sees the ankle, with the ankle's error and one of their own; neck, hips' middle and top of the head
are as wrong as the joints that they lie between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera
from e3pose.model.skeleton import BODY25, COCO17, HALPE26, MEANS, Skeleton
from e3pose.recording import Recording, Truth, ViewSeries

SKELETONS = {skeleton.name: skeleton for skeleton in (COCO17, BODY25, HALPE26)}
# From the ankle, ahead, outward and up; metres of an adult: a foot is 0.152 of the stature long
# (Winter, Biomechanics and Motor Control of Human Movement).
FOOT_M = {
    "big_toe": (0.19, -0.02, -0.06),
    "small_toe": (0.15, 0.06, -0.065),
    "heel": (-0.06, 0.0, -0.055),
}
HEAD_M = 0.17  # from the middle of the ears to the top of the head
OWN_ERROR = 0.7  # of the ankle's, in pixels; drawn anew in every frame


def with_skeleton(recording: Recording, name: str, seed: int) -> Recording:
    """Return a simulated recording in another skeleton.

    Args:
        recording: simulated, in COCO-17 with its truth.
        name: `coco17`, `body25` or `halpe26`.
        seed: of the errors of added keypoints.

    Raises:
        InputError: for another skeleton.
    """
    if name not in SKELETONS:
        raise InputError("skeleton", repr(name)[:60], ", ".join(SKELETONS))
    skeleton, truth = SKELETONS[name], recording.truth
    if skeleton == COCO17 or truth is None:
        return recording
    joints_m = add_joints(truth.joints_m, skeleton)
    rng = np.random.default_rng(seed)
    views = tuple(
        _series(series, camera, truth.joints_m, joints_m, skeleton, rng)
        for series, camera in zip(recording.views, recording.rig.cameras, strict=True)
    )
    return replace(
        recording,
        skeleton=skeleton,
        views=views,
        truth=Truth(skeleton, truth.person_ids, joints_m),
    )


def add_joints(joints_m: Floats, skeleton: Skeleton) -> Floats:
    """Return people with the joints of a skeleton.

    Args:
        joints_m: `(*batch, 17, 3)` COCO-17, z up.
        skeleton: wanted.

    Returns:
        `(*batch, num_joints, 3)`; NaN where the 17 are.
    """
    found: dict[str, Floats] = {j: joints_m[..., i, :] for i, j in enumerate(COCO17.joints)}
    for joint, parts in MEANS.items():
        found[joint] = np.mean([found[part] for part in parts], axis=0)
    found["top_head"] = found["mid_ear"] + [0.0, 0.0, HEAD_M]
    across = found["left_hip"] - found["right_hip"]
    left = across * [1.0, 1.0, 0.0]
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    ahead = np.cross(left, [0.0, 0.0, 1.0])
    for side, outward in (("left", left), ("right", -left)):
        for part, (forward, out, up) in FOOT_M.items():
            ankle = found[f"{side}_ankle"]
            found[f"{side}_{part}"] = ankle + forward * ahead + out * outward + [0.0, 0.0, up]
    return np.stack([found[joint] for joint in skeleton.joints], axis=-2)


def _series(
    series: ViewSeries,
    camera: Camera,
    coco_m: Floats,
    joints_m: Floats,
    skeleton: Skeleton,
    rng: np.random.Generator,
) -> ViewSeries:
    """Return a camera's views with the keypoints of a skeleton."""
    counts = np.diff(series.starts)
    slots = np.repeat(series.slots, counts)
    keypoints = np.full((len(slots), len(skeleton), 2), np.nan)
    scores = np.zeros((len(slots), len(skeleton)))
    places, wanted = camera.project(coco_m[slots]), camera.project(joints_m[slots])
    off = series.keypoints_px[:, None] - places  # (num_poses, num_persons, 17, 2)
    distance = np.linalg.norm(off, axis=-1)
    known = np.isfinite(distance)
    mean = np.where(known, distance, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    mean = np.where(known.any(axis=-1), mean, np.inf)
    whose = mean.argmin(axis=1) if mean.shape[1] else np.zeros(len(slots), dtype=np.int64)
    each = np.arange(len(slots))
    for index, joint in enumerate(skeleton.joints):
        parts = _like(joint)
        columns = [COCO17.joints.index(part) for part in parts]
        if joint in COCO17.joints:
            keypoints[:, index] = series.keypoints_px[:, columns[0]]
            scores[:, index] = series.scores[:, columns[0]]
            continue
        error = off[each, whose][:, columns].mean(axis=1)  # NaN unless all parts were seen
        own = OWN_ERROR * rng.standard_normal(error.shape) * np.abs(error)
        own = own if joint.endswith(("toe", "heel")) else 0.0
        keypoints[:, index] = wanted[each, whose, index] + error + own
        scores[:, index] = series.scores[:, columns].min(axis=1)
    with np.errstate(invalid="ignore"):
        inside = (keypoints >= -0.5) & (keypoints <= np.array(camera.image_size) - 0.5)
    seen = inside.all(axis=-1) & (scores > 0)
    return replace(
        series,
        keypoints_px=np.where(seen[..., None], keypoints, np.nan),
        scores=np.where(seen, scores, 0.0),
    )


def _like(joint: str) -> tuple[str, ...]:
    """Return the joints of COCO-17 whose errors a joint has."""
    side = joint.partition("_")[0]
    if joint.endswith(("toe", "heel")):
        return (f"{side}_ankle",)
    return MEANS["mid_ear"] if joint == "top_head" else MEANS.get(joint, (joint,))
