"""The body as a tree: correlations between neighbouring joints.

A person is a Gaussian tree. Given its parent, a joint does not depend on the rest of the body:

    x_j | x_p ~ N(m_j + G_j (x_p - m_p), S_j),   G_j = C_j P_p^-1,   S_j = P_j - G_j C_j'

with m and P the mean and covariance of a joint's position and velocity, and C_j its covariance with
its parent. Keypoints inform single joints and bones pairs of neighbours, so the posterior is a tree
again, exact in one pass from the leaves to the root and one back (Pearl's belief propagation). Over
time the marginals and the C_j are carried: of all trees the one nearest to the true distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.model.skeleton import Skeleton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Habit(NamedTuple):
    """Motion of a kind of joint relative to its parent; of a root: in the world.

    Attributes:
        acceleration_mps2: how strongly it accelerates, as white noise drawn anew every 1/25 s.
        lasts_s: until a velocity that nobody sees again is down to 1/e.
        usual_m: how far it usually is from its parent, where that is not learned; else 0.
    """

    acceleration_mps2: float
    lasts_s: float
    usual_m: float = 0.0


TRUNK, STIFF = Habit(4.3, 0.78), Habit(2.9, 0.4)  # the body; spine, girdles and head
FACE = Habit(1.6, 0.4)
MIDDLE, END = Habit(6.2, 0.25), Habit(8.2, 0.2)  # elbows and knees; wrists and ankles
# A foot turns as CMU's motion capture does beside the ankle, by the distance from it, half as
# strongly again, as the ankle's habit is to CMU's. Their bones are too short to be learned; usual
# lengths keep feet near ankles that are better known than they, as feet are seen less often.
TOE = Habit(9.0, 0.15, usual_m=0.2)
SMALL_TOE = Habit(4.0, 0.15, usual_m=0.09)
HEEL = Habit(3.5, 0.15, usual_m=0.08)
# Each joint's parent, the first one that the skeleton has, and how it moves beside it.
PARENTS: dict[str, tuple[tuple[str, ...], Habit]] = {
    "mid_hip": ((), TRUNK),
    "left_hip": (("mid_hip",), STIFF),
    "right_hip": (("mid_hip", "left_hip"), STIFF),
    "neck": (("mid_hip", "left_hip"), STIFF),
    "left_shoulder": (("neck", "left_hip"), STIFF),
    "right_shoulder": (("neck", "left_shoulder"), STIFF),
    "nose": (("neck", "left_shoulder"), STIFF),
    **{f"{s}_eye": (("nose",), FACE) for s in ("left", "right")},
    **{f"{s}_ear": ((f"{s}_eye", "nose"), FACE) for s in ("left", "right")},
    **{f"{s}_elbow": ((f"{s}_shoulder",), MIDDLE) for s in ("left", "right")},
    **{f"{s}_wrist": ((f"{s}_elbow",), END) for s in ("left", "right")},
    **{f"{s}_knee": ((f"{s}_hip",), MIDDLE) for s in ("left", "right")},
    **{f"{s}_ankle": ((f"{s}_knee",), END) for s in ("left", "right")},
    **{f"{s}_big_toe": ((f"{s}_ankle",), TOE) for s in ("left", "right")},
    **{f"{s}_small_toe": ((f"{s}_big_toe",), SMALL_TOE) for s in ("left", "right")},
    **{f"{s}_heel": ((f"{s}_ankle",), HEEL) for s in ("left", "right")},
    "top_head": (("neck", "nose"), STIFF),
}


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """The tree of a skeleton.

    Attributes:
        parents: `(num_joints,)` index of each joint's parent, -1 at the root.
        levels: joints by their distance from the root, the root first.
        order: `(num_joints,)` the same in a row, each joint after its parent.
        drift_m2ps4: `(num_joints,)` variance of a joint's acceleration beside its parent.
        lasts_s: `(num_joints,)` life of its velocity beside its parent.
        usual_m: `(num_joints,)` its usual distance from its parent; 0 where none is known.
    """

    parents: Ints
    levels: tuple[Ints, ...]
    order: Ints
    drift_m2ps4: Floats
    lasts_s: Floats
    usual_m: Floats


def grow(skeleton: Skeleton) -> Tree:
    """Return the tree of a skeleton; orphans become children of the first root."""
    names = skeleton.joints
    own = {name: PARENTS.get(name, ((), END)) for name in names}
    above = {name: next((p for p in own[name][0] if p in names), "") for name in names}
    ranks = {name: rank for rank, name in enumerate(PARENTS)}
    root = min((n for n in names if not above[n]), key=lambda n: ranks.get(n, len(ranks)))
    parents = [-1 if n == root else names.index(above[n] or root) for n in names]
    order = [names.index(root)]
    for joint in order:
        order.extend(child for child, parent in enumerate(parents) if parent == joint)
    depth = np.zeros(len(names), dtype=np.int64)
    for joint in order[1:]:
        depth[joint] = depth[parents[joint]] + 1
    levels = tuple(np.flatnonzero(depth == d) for d in range(depth.max() + 1))
    habits = np.array([TRUNK if n == root else own[n][1] for n in names])
    lasts_s, usual_m = np.ascontiguousarray(habits[:, 1:].T)
    return Tree(
        np.array(parents, dtype=np.int64),
        levels,
        np.concatenate(levels),
        habits[:, 0] ** 2,
        lasts_s,
        usual_m,
    )
