"""Skeletons: joint names and limbs of the conventions in use, and conversion between them.

Joint names are snake_case and shared between skeletons: `left_shoulder` is the same anatomical
point everywhere, so conversion is by name, plus a few joints that are means of others, plus the one
special case of Shelf-14, whose head joints no detector gives.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError

# A joint that a skeleton lacks is the mean of these, if it has all of them.
MEANS = {
    "mid_hip": ("left_hip", "right_hip"),
    "neck": ("left_shoulder", "right_shoulder"),
    "mid_ear": ("left_ear", "right_ear"),
}
BODY_LIMBS = (
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("left_shoulder", "left_hip"),
    ("right_shoulder", "right_hip"),
    ("left_shoulder", "left_elbow"),
    ("left_elbow", "left_wrist"),
    ("right_shoulder", "right_elbow"),
    ("right_elbow", "right_wrist"),
    ("left_hip", "left_knee"),
    ("left_knee", "left_ankle"),
    ("right_hip", "right_knee"),
    ("right_knee", "right_ankle"),
)
BODY_JOINTS = frozenset(joint for limb in BODY_LIMBS for joint in limb)
FACE_LIMBS = (
    ("nose", "left_eye"),
    ("nose", "right_eye"),
    ("left_eye", "left_ear"),
    ("right_eye", "right_ear"),
)


@dataclass(frozen=True, slots=True)
class Skeleton:
    """A convention: joint names in axis order, and limbs as pairs of joint indices."""

    name: str
    joints: tuple[str, ...]
    limbs: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.joints)

    def index(self, joint: str) -> int:
        """Return where `joint` stands on the joint axis; raise `InputError` if it is not there."""
        try:
            return self.joints.index(joint)
        except ValueError:
            raise InputError(f"skeleton {self.name} has no joint {joint!r}") from None


def _skeleton(name: str, joints: str, limbs: tuple[tuple[str, str], ...]) -> Skeleton:
    names = tuple(joints.split())
    return Skeleton(name, names, tuple((names.index(a), names.index(b)) for a, b in limbs))


_COCO17 = """nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow
right_elbow left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"""
_COCO18 = """nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist
right_hip right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear
left_ear"""
_BODY25 = """nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist
mid_hip right_hip right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear
left_ear left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel"""
_HALPE26 = (
    _COCO17
    + """ top_head neck mid_hip left_big_toe right_big_toe left_small_toe
right_small_toe left_heel right_heel"""
)
_SHELF14 = """right_ankle right_knee right_hip left_hip left_knee left_ankle right_wrist right_elbow
right_shoulder left_shoulder left_elbow left_wrist bottom_head top_head"""
_PANOPTIC19 = """neck nose mid_hip left_shoulder left_elbow left_wrist left_hip left_knee
left_ankle right_shoulder right_elbow right_wrist right_hip right_knee right_ankle left_eye
left_ear right_eye right_ear"""
# A CMU bone is named after itself and placed at its far end: `lfemur` ends in the knee.
_CMU31 = """mid_hip left_hip right_hip lower_back left_knee left_ankle left_foot left_toes
right_knee right_ankle right_foot right_toes upper_back thorax neck left_shoulder right_shoulder
upper_neck top_head left_elbow left_wrist left_palm left_hand left_thumb left_fingers
right_elbow right_wrist right_palm right_hand right_thumb right_fingers"""

_NECK_LIMBS = (("neck", "nose"), *BODY_LIMBS)
_FEET_LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("ankle", "big_toe"), ("big_toe", "small_toe"), ("ankle", "heel"))
)
_CMU_LIMBS = (
    ("mid_hip", "left_hip"), ("mid_hip", "right_hip"), ("mid_hip", "lower_back"),
    ("lower_back", "upper_back"), ("upper_back", "thorax"), ("thorax", "neck"),
    ("neck", "upper_neck"), ("upper_neck", "top_head"),
    ("thorax", "left_shoulder"), ("thorax", "right_shoulder"), *BODY_LIMBS[4:],
    *((f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in (
        ("ankle", "foot"), ("foot", "toes"), ("wrist", "palm"), ("palm", "hand"),
        ("wrist", "thumb"), ("hand", "fingers"))),
)  # fmt: skip

COCO17 = _skeleton("coco17", _COCO17, (*BODY_LIMBS, *FACE_LIMBS))
COCO18 = _skeleton("coco18", _COCO18, (*_NECK_LIMBS, *FACE_LIMBS))
BODY25 = _skeleton("body25", _BODY25, (*_NECK_LIMBS, *FACE_LIMBS, *_FEET_LIMBS))
HALPE26 = _skeleton(
    "halpe26",
    _HALPE26,
    (*_NECK_LIMBS, *FACE_LIMBS, ("neck", "top_head"), *_FEET_LIMBS),
)
SHELF14 = _skeleton("shelf14", _SHELF14, (*BODY_LIMBS, ("bottom_head", "top_head")))
PANOPTIC19 = _skeleton("panoptic19", _PANOPTIC19, (*_NECK_LIMBS, *FACE_LIMBS))
CMU31 = _skeleton("cmu31", _CMU31, _CMU_LIMBS)
SKELETONS = {s.name: s for s in (COCO17, COCO18, BODY25, HALPE26, SHELF14, PANOPTIC19, CMU31)}


def skeleton_by_name(name: str) -> Skeleton:
    """Return the skeleton called `name`; raise `InputError` listing the known ones if none is."""
    if name not in SKELETONS:
        raise InputError(
            f"skeleton {name[:40]!r} is unknown, expected one of {', '.join(SKELETONS)}"
        )
    return SKELETONS[name]


def skeleton_of_joints(joints: tuple[str, ...], name: str = "") -> Skeleton:
    """Return the known skeleton with these joints, of this name if it has one; else one of points.

    Args:
        joints: their names, in order.
        name: of the skeleton; empty for that of whichever has the joints.
    """
    known = SKELETONS.values() if not name else [SKELETONS[name]] if name in SKELETONS else []
    found = next((one for one in known if one.joints == joints), None)
    return found or Skeleton(name or "live", joints, ())


def lacking(joints: Collection[str], target: Collection[str]) -> tuple[str, ...]:
    """Return the joints of a target that cannot be had from others, neither as is nor as means.

    Args:
        joints: names of those that there are.
        target: names of those wanted.
    """
    return tuple(
        joint
        for joint in target
        if joint not in joints and not (joint in MEANS and set(MEANS[joint]) <= set(joints))
    )


def serves(joints: Collection[str], target: Collection[str]) -> bool:
    """Return whether poses with these joints can stand for those of a target: no limb is lost."""
    return not set(lacking(joints, target)) & (set(target) & BODY_JOINTS or set(target))


def convert(
    positions: Floats, scores: Floats, source: Skeleton, target: Skeleton
) -> tuple[Floats, Floats]:
    """Express poses of one skeleton in another.

    Args:
        positions: `(*batch, num_joints, 2 or 3)` pixels or metres, NaN where missing.
        scores: `(*batch, num_joints)` in [0, 1], 0 where missing.
        source: the skeleton of the arguments.
        target: the skeleton wanted.

    Returns:
        Positions and scores with the target's joint axis; a joint that the source cannot give is
        NaN with score 0. A mean of joints takes the lowest of their scores. COCO-17 to Shelf-14 in
        3D estimates the head from face and shoulders (z up), as the Shelf protocol does.

    Raises:
        InputError: when the shapes do not fit the source skeleton.
    """
    if positions.shape[-2] != len(source) or scores.shape != positions.shape[:-1]:
        raise InputError(
            f"convert: positions {positions.shape} and scores {scores.shape} do not fit "
            f"skeleton {source.name} of {len(source)} joints"
        )
    if source == target:
        return positions, scores
    if target == SHELF14 and positions.shape[-1] == 3 and set(COCO17.joints) <= set(source.joints):
        return _shelf14(*convert(positions, scores, source, COCO17))
    new_positions = np.full((*positions.shape[:-2], len(target), positions.shape[-1]), np.nan)
    new_scores = np.zeros((*scores.shape[:-1], len(target)))
    for index, joint in enumerate(target.joints):
        names = (joint,) if joint in source.joints else MEANS.get(joint, ())
        if names and set(names) <= set(source.joints):
            columns = [source.joints.index(name) for name in names]
            new_positions[..., index, :] = positions[..., columns, :].mean(axis=-2)
            new_scores[..., index] = scores[..., columns].min(axis=-1)
    return np.where(new_scores[..., None] > 0, new_positions, np.nan), new_scores


def _shelf14(joints_m: Floats, scores: Floats) -> tuple[Floats, Floats]:
    """Map COCO-17 in metres, z up, to Shelf-14 by the formulas of the Shelf PCP protocol.

    The protocol takes the nose and both ears. Few cameras seldom see them all, so the nearest face
    joints that were seen stand in: for the mid-ear one ear, else the eyes, else the nose; for the
    nose the eyes, else the ears. With nose and ears seen this is the protocol to the letter.
    """
    body = [COCO17.joints.index(name) for name in SHELF14.joints[:12]]
    face = [_mean_seen(joints_m, scores, columns) for columns in ([3, 4], [1, 2], [0])]
    ears, eyes, nose_seen = face
    head_centre, centre_score = _first_seen(ears, eyes, nose_seen)
    nose, nose_score = _first_seen(nose_seen, eyes, ears)
    middle_shoulder = joints_m[..., [5, 6], :].mean(axis=-2)
    head_bottom = (middle_shoulder + head_centre) / 2
    head_top = head_bottom + 2 * (head_centre - head_bottom)
    forward = nose - middle_shoulder
    bottom = 0.75 * (middle_shoulder + 0.5 * forward) + 0.25 * head_bottom
    top = 0.75 * (middle_shoulder + forward * [0.75, 0.75, 1.5]) + 0.25 * head_top
    new_joints = np.concatenate(
        [joints_m[..., body, :], bottom[..., None, :], top[..., None, :]], axis=-2
    )
    shoulder_score = scores[..., [5, 6]].min(axis=-1)
    head_score = np.minimum(np.minimum(centre_score, nose_score), shoulder_score)[..., None]
    new_scores = np.concatenate([scores[..., body], head_score, head_score], axis=-1)
    return np.where(new_scores[..., None] > 0, new_joints, np.nan), new_scores


def _mean_seen(joints_m: Floats, scores: Floats, columns: list[int]) -> tuple[Floats, Floats]:
    """Return the mean `(*batch, 3)` of those joints that were seen and the best of their scores."""
    seen = scores[..., columns] > 0
    total = np.where(seen[..., None], joints_m[..., columns, :], 0.0).sum(axis=-2)
    count = seen.sum(axis=-1)
    mean = total / np.maximum(count, 1)[..., None]
    return np.where(count[..., None] > 0, mean, np.nan), scores[..., columns].max(axis=-1)


def _first_seen(*choices: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    position, score = choices[-1]
    for earlier_position, earlier_score in choices[-2::-1]:
        position = np.where(earlier_score[..., None] > 0, earlier_position, position)
        score = np.where(earlier_score > 0, earlier_score, score)
    return position, score


def common_skeleton(detectors: Iterable[Skeleton]) -> Skeleton:
    """Return the skeleton in which poses of several detectors are told.

    Args:
        detectors: what each of them outputs.

    Returns:
        That of theirs which lacks fewest joints in any of them, and of several the one with fewest
        joints, as what a detector does not find is made of others; COCO's without a detector.
    """
    known = list(dict.fromkeys(detectors))

    def cost(target: Skeleton) -> tuple[int, int]:
        return sum(len(lacking(other.joints, target.joints)) for other in known), len(target)

    return min(known, key=cost, default=COCO17)
