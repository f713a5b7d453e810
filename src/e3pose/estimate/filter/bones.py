"""The bones of a skeleton: which lengths are learned, and which limbs stay together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter.tree import Tree
from e3pose.model.proportions import KINDS, kind_of
from e3pose.model.skeleton import BODY_LIMBS, FACE_LIMBS, SIDES, Skeleton

GIRDLES = ("shoulder", "hip")
STIFF = (
    *BODY_LIMBS,
    ("left_shoulder", "right_hip"),
    ("right_shoulder", "left_hip"),
    *FACE_LIMBS,
    ("left_eye", "right_eye"),
    ("left_ear", "right_ear"),
)
# tuned: m | simulated: 4, 3, 2.2 cm give 21.8, 21.4, 21.3 mm, but coverage falls | learned bones
STIFF_SLACK_M = 0.03  # detectors slide joints along the body by about this
# A head turns and nods: what it does to these lengths is a few centimetres.
LOOSE = tuple((f, f"{s}_shoulder") for f in ("nose", "left_ear", "right_ear") for s in SIDES)
# tuned: m | simulated | learned bones
LOOSE_SLACK_M = 0.08
# Joints of which detectors exchange left and right together, with all that hangs on them.
LIMBS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))


class Proportions(NamedTuple):
    """The bones of a skeleton, as kernels take them.

    Attributes:
        bones: `(num_bones, 2)` joints that stay about as far apart as they are.
        slacks_m: `(num_bones,)` how far the length of a bone strays, as a standard deviation.
        links: `(num_joints,)` the bone between each joint and its parent, -1 where there is none.
        order: `(num_joints,)` the root first, each joint after its parent.
        parents: `(num_joints,)` -1 at the root.
        limbs: `(num_joints,)` of arms 1, of legs 2, else 0.
        kinds: `(num_bones,)` row of the next two, -1 where nothing is known of people.
        shares: `(num_kinds,)` logarithms of shares of the stature.
        spreads: `(num_kinds,)` of a logarithm, given the stature.
        gives: `(num_bones,)` factor by which a shown limb may be longer or shorter; 0 for any.
        anchored: `(num_bones,)` limbs of which the first joint is of the trunk.
    """

    bones: Integers
    slacks_m: Floats
    links: Integers
    order: Integers
    parents: Integers
    limbs: Integers
    kinds: Integers
    shares: Floats
    spreads: Floats
    gives: Floats
    anchored: Flags


def proportions_of(skeleton: Skeleton, tree: Tree) -> Proportions:
    """Return the bones of a skeleton, and its tree."""
    joints = skeleton.joints
    pairs = [
        (pair, slack_m)
        for links, slack_m in ((STIFF, STIFF_SLACK_M), (LOOSE, LOOSE_SLACK_M))
        for pair in links
        if set(pair) <= set(joints)
    ]
    ends = [[joints.index(a), joints.index(b)] for (a, b), _ in pairs]
    rows = {frozenset(pair): row for row, pair in enumerate(ends)}
    edges = enumerate(tree.parents.tolist())
    kinds = np.array([kind_of(*pair) for pair, _ in pairs], dtype=np.int64)
    gives = np.array([*(kind.give for kind in KINDS.values()), 0.0])
    return Proportions(
        bones=np.array(ends, dtype=np.int64).reshape(-1, 2),
        slacks_m=np.array([slack_m for _, slack_m in pairs]),
        links=np.array([rows.get(frozenset(edge), -1) for edge in edges], dtype=np.int64),
        order=np.ascontiguousarray(tree.order),
        parents=np.ascontiguousarray(tree.parents),
        limbs=limbs_of(skeleton, tree),
        kinds=kinds,
        shares=np.log([kind.share for kind in KINDS.values()]),
        spreads=np.array([kind.spread for kind in KINDS.values()]),
        gives=gives[kinds],
        anchored=np.array([_is_anchored(*pair) for pair, _ in pairs], dtype=bool),
    )


def _is_anchored(first: str, second: str) -> bool:
    trunk = {f"{side}_{girdle}" for side in SIDES for girdle in GIRDLES}
    return kind_of(first, second) >= 0 and first in trunk and second not in trunk


def limbs_of(skeleton: Skeleton, tree: Tree) -> Integers:
    """Return `(num_joints,)` 1 for arm joints, 2 for leg joints, 0 without a counterpart."""
    limbs = np.zeros(len(skeleton), dtype=np.int64)
    known = {f"{side}_{name}": row for row, names in enumerate(LIMBS, 1) for name in names
             for side in SIDES}  # fmt: skip
    paired = {joint for pair in skeleton.pairs for joint in pair}
    for joint in tree.order.tolist():
        if joint in paired:
            limbs[joint] = known.get(skeleton.joints[joint], limbs[tree.parents[joint]])
    return limbs
