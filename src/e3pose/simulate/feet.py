"""Add joints that COCO-17 lacks to a simulated recording: feet, hands, faces.

Feet are rigid and flat, and point where the hips face; hands are rigid and in line with forearms;
faces are rigid on heads (`rest` of skeletons). A camera sees a joint where it sees the joint of
COCO-17 that it hangs on, with that joint's error and one of its own; neck, hips' middle and top of
the head are as wrong as the joints that they lie between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera
from e3pose.model.skeleton import COCO17, DETAILS, MEANS, SIDES, SKELETONS, Skeleton, load_skeleton
from e3pose.recording import Recording, Truth, ViewSeries

# From the ankle, ahead, outward and up; metres of an adult: a foot is 0.152 of the stature long
# (Winter, Biomechanics and Motor Control of Human Movement).
FOOT_M = {
    "big_toe": (0.19, -0.02, -0.06),
    "small_toe": (0.15, 0.06, -0.065),
    "heel": (-0.06, 0.0, -0.055),
}
SPINE, NAPE = 0.5, 0.4  # of the ways from hips to neck, and from there to the ears
HEAD_M = 0.17  # from the middle of the ears to the top of the head
OWN_ERROR = 0.7  # of the ankle's, in pixels; drawn anew in every frame


def with_skeleton(recording: Recording, name: str, seed: int) -> Recording:
    """Return a simulated recording in another skeleton.

    Args:
        recording: simulated, in COCO-17 with its truth.
        name: of a skeleton, or its file.
        seed: of the errors of added keypoints.

    Raises:
        InputError: for a skeleton with joints that cannot be simulated.
    """
    skeleton, truth = load_skeleton(name), recording.truth
    if skeleton == COCO17 or truth is None:
        return recording
    if unknown := _unknown(skeleton):
        known = ", ".join(one.name for one in SKELETONS.values() if not _unknown(one))
        wanted = f"joints of {known}, or their place in [rest]"
        raise InputError("--skeleton", f"{skeleton.name} with {unknown}", wanted)
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

    Raises:
        KeyError: naming a joint of which nothing says where it is.
    """
    found: dict[str, Floats] = {j: joints_m[..., i, :] for i, j in enumerate(COCO17.joints)}
    for joint, parts in MEANS.items():
        found[joint] = np.mean([found[part] for part in parts], axis=0)
    found["top_head"] = found["mid_ear"] + [0.0, 0.0, HEAD_M]
    found["spine"] = found["mid_hip"] + SPINE * (found["neck"] - found["mid_hip"])
    found["upper_neck"] = found["neck"] + NAPE * (found["mid_ear"] - found["neck"])
    left = _unit((found["left_hip"] - found["right_hip"]) * [1.0, 1.0, 0.0])
    ahead = np.cross(left, [0.0, 0.0, 1.0])
    for side, outward in (("left", left), ("right", -left)):
        for part, (forward, out, up) in FOOT_M.items():
            ankle = found[f"{side}_ankle"]
            found[f"{side}_{part}"] = ankle + forward * ahead + out * outward + [0.0, 0.0, up]
    axes = {
        f"{side}_wrist": _axes(found[f"{side}_wrist"] - found[f"{side}_elbow"], ahead)
        for side in SIDES
    }
    axes["nose"] = _axes(found["nose"] - found["mid_ear"], found["left_ear"] - found["right_ear"])
    waiting = [index for index, joint in enumerate(skeleton.joints) if joint not in found]
    while waiting:
        placed = [i for i in waiting if _above(i, skeleton) in found]
        if not placed:  # on a root of its own
            raise KeyError(skeleton.joints[waiting[0]])
        for index in placed:
            parent = _above(index, skeleton)
            rest_m = np.array(skeleton.rest_m[index] if skeleton.rest_m else (np.nan,) * 3)
            if parent in axes:
                axes[skeleton.joints[index]] = axes[parent]
            elif skeleton.moves[index] in DETAILS:  # of the face beside the nose, as eyes are
                axes[skeleton.joints[index]] = axes["nose"]
            if np.isnan(rest_m).any() or skeleton.joints[index] not in axes:
                raise KeyError(skeleton.joints[index])
            found[skeleton.joints[index]] = found[parent] + axes[skeleton.joints[index]] @ rest_m
        waiting = [i for i in waiting if i not in placed]
    return np.stack([found[joint] for joint in skeleton.joints], axis=-2)


def _above(index: int, skeleton: Skeleton) -> str:
    """Return the parent of a joint: for hands and faces alone, their person's wrist and nose."""
    if skeleton.parents[index] >= 0:
        return skeleton.joints[skeleton.parents[index]]
    side = skeleton.joints[index].partition("_")[0]
    return f"{side}_wrist" if side in SIDES else "nose"


def _axes(along: Floats, aside: Floats) -> Floats:
    """Return `(*batch, 3, 3)`: columns along, to the side that is nearest to `aside`, and up."""
    first = _unit(along)
    second = _unit(aside - (aside * first).sum(axis=-1, keepdims=True) * first)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _unit(vectors: Floats) -> Floats:
    """Return vectors of length 1."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-9))


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
    for index, (joint, how) in enumerate(zip(skeleton.joints, skeleton.moves, strict=True)):
        parts = _like(joint, skeleton)
        columns = [COCO17.joints.index(part) for part in parts]
        if joint in COCO17.joints:
            keypoints[:, index] = series.keypoints_px[:, columns[0]]
            scores[:, index] = series.scores[:, columns[0]]
            continue
        error = off[each, whose][:, columns].mean(axis=1)  # NaN unless all parts were seen
        own = OWN_ERROR * rng.standard_normal(error.shape) * np.abs(error)
        own = own if joint.endswith(("toe", "heel")) or how in DETAILS else 0.0
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


def _like(joint: str, skeleton: Skeleton) -> tuple[str, ...]:
    """Return the joints of COCO-17 whose errors a joint has."""
    if joint in ("top_head", "upper_neck"):
        return MEANS["mid_ear"]
    while joint not in COCO17.joints and joint not in MEANS:
        joint = _above(skeleton.index(joint), skeleton)
    return MEANS.get(joint, (joint,))


def _unknown(skeleton: Skeleton) -> str:
    """Return a joint of which nothing says where it is; empty if there is none."""
    try:
        add_joints(np.zeros((0, len(COCO17), 3)), skeleton)
    except KeyError as error:
        return str(error.args[0])
    return ""
