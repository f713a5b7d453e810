"""The body as a tree: what is learned about one joint tells about its neighbours.

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

from e3pose.skeleton import Skeleton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Habit(NamedTuple):
    """How a kind of joint moves beside its parent; a root: in the world.

    Attributes:
        acceleration_mps2: how strongly it accelerates, as white noise drawn anew every 1/25 s.
        lasts_s: until a velocity that nobody sees again is down to 1/e.
        swing_per_s2: how strongly it is drawn below its parent while the person walks.
    """

    acceleration_mps2: float
    lasts_s: float
    swing_per_s2: float = 0.0


TRUNK, SPINE, GIRDLE = Habit(4.3, 0.78), Habit(3.0, 0.4), Habit(2.4, 0.4)
HEAD, FACE = Habit(2.9, 0.4), Habit(1.6, 0.4)
ELBOW, WRIST = Habit(6.2, 0.25, 6.0), Habit(8.2, 0.2, 12.0)
KNEE, ANKLE = Habit(6.2, 0.25, 12.0), Habit(8.2, 0.2, 12.0)
OTHER = Habit(8.2, 0.2)  # a joint of no name known here
# Each joint's parent, the first one that the skeleton has, and how it moves beside it.
PARENTS: dict[str, tuple[tuple[str, ...], Habit]] = {
    "mid_hip": ((), TRUNK),
    "left_hip": (("mid_hip",), GIRDLE),
    "right_hip": (("mid_hip", "left_hip"), GIRDLE),
    "neck": (("mid_hip", "left_hip"), SPINE),
    "left_shoulder": (("neck", "left_hip"), SPINE),
    "right_shoulder": (("neck", "left_shoulder"), GIRDLE),
    "nose": (("neck", "left_shoulder"), HEAD),
    **{f"{s}_eye": (("nose",), FACE) for s in ("left", "right")},
    **{f"{s}_ear": ((f"{s}_eye", "nose"), FACE) for s in ("left", "right")},
    **{f"{s}_elbow": ((f"{s}_shoulder",), ELBOW) for s in ("left", "right")},
    **{f"{s}_wrist": ((f"{s}_elbow",), WRIST) for s in ("left", "right")},
    **{f"{s}_knee": ((f"{s}_hip",), KNEE) for s in ("left", "right")},
    **{f"{s}_ankle": ((f"{s}_knee",), ANKLE) for s in ("left", "right")},
}


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """The tree of a skeleton.

    Attributes:
        parents: `(num_joints,)` index of each joint's parent, -1 at the root.
        levels: joints by their distance from the root, the root first.
        drift_m2ps4: `(num_joints,)` variance of a joint's acceleration beside its parent.
        lasts_s: `(num_joints,)` life of its velocity beside its parent.
        swing_per_s2: `(num_joints,)` how strongly it swings below its parent.
    """

    parents: Ints
    levels: tuple[Ints, ...]
    drift_m2ps4: Floats
    lasts_s: Floats
    swing_per_s2: Floats


def grow(skeleton: Skeleton) -> Tree:
    """Return the tree of a skeleton; joints without a parent in it hang on the first such one."""
    names = skeleton.joints
    own = {name: PARENTS.get(name, ((), OTHER)) for name in names}
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
    return Tree(np.array(parents, dtype=np.int64), levels, habits[:, 0] ** 2, *habits[:, 1:].T)


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Bones between each joint and its parent, as seen from the prediction's mean.

    Attributes:
        along: `(num_tracks, num_joints, 3)` unit vectors from parent to joint.
        excess_m: `(num_tracks, num_joints)` length of the predicted bone, along `along`, above the
            length that it should have.
        weights: `(num_tracks, num_joints)` 1 / slack^2; 0 where no length is known.
    """

    along: Floats
    excess_m: Floats
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Conditionals:
    """Each joint given its parent, `(num_tracks, num_joints, 6, 6)` each: G and S above."""

    gains: Floats
    covariance: Floats


def conditionals(tree: Tree, covariance: Floats, shared: Floats) -> Conditionals:
    """Return G and S of `(num_tracks, num_joints, 6, 6)` marginals P and shared covariances C."""
    parents = np.maximum(tree.parents, 0)  # the root's C is 0, hence its G is
    gains = _T(np.asarray(np.linalg.solve(covariance[:, parents], _T(shared))))
    return Conditionals(gains, _symmetric(covariance - gains @ _T(shared)))


def solve(
    tree: Tree, prior: Conditionals, information: Floats, pull: Floats, links: Links
) -> tuple[Floats, Floats, Floats]:
    """Return the posterior of all joints: the least sum of squares over the tree.

    Minimises over the deviations d from the prior's mean

        |d_j - G_j d_p|^2 / S_j  +  d_j' J_j d_j - 2 h_j' d_j  +  w_j (u_j'(d_j - d_p) + c_j)^2

    summed over joints, where the middle is what keypoints say and the last what bones say. From the
    leaves to the root each joint is eliminated, which leaves a J and an h with its parent; on the
    way back each takes its place, given its parent's.

    Args:
        tree: of the skeleton.
        prior: G and S.
        information: `(num_tracks, num_joints, 6, 6)` J, may be singular.
        pull: `(num_tracks, num_joints, 6)` h.
        links: u, c and w.

    Returns:
        d `(num_tracks, num_joints, 6)`, its covariance and that with the parent,
        `(num_tracks, num_joints, 6, 6)` each.
    """
    J, h, given = information.copy(), pull.copy(), np.zeros_like(prior.gains)
    own = np.zeros_like(prior.covariance)  # M, of a joint given its parent, after the slot
    bone = np.zeros_like(J)
    bone[..., :3, :3] = (
        links.weights[..., None, None] * links.along[..., :, None] * links.along[..., None, :]
    )
    tension = np.zeros_like(h)
    tension[..., :3] = (links.weights * links.excess_m)[..., None] * links.along
    for level in reversed(tree.levels):
        S, G, B = prior.covariance[:, level], prior.gains[:, level], bone[:, level]
        local, force = J[:, level] + B, h[:, level] - tension[:, level]
        T = np.linalg.inv(np.eye(6) + S @ local)
        own[:, level] = T @ S
        TG = T @ G
        MB = own[:, level] @ B
        given[:, level] = TG + MB  # d_j = M force + given d_p
        h[:, level] = force
        parents = tree.parents[level]
        if parents[0] < 0:
            break
        BTG = B @ TG
        message = _T(G) @ local @ TG - BTG - _T(BTG) - B @ MB + B
        passed = _times(_T(given[:, level]), force) + tension[:, level]
        for child, parent in enumerate(parents.tolist()):
            J[:, parent] += message[:, child]
            h[:, parent] += passed[:, child]
    moved, covariance = _times(own, h), own
    shared = np.zeros_like(own)
    for level in tree.levels[1:]:
        parents = tree.parents[level]
        moved[:, level] += _times(given[:, level], moved[:, parents])
        shared[:, level] = given[:, level] @ covariance[:, parents]
        covariance[:, level] += shared[:, level] @ _T(given[:, level])
    return moved, _symmetric(covariance), shared


def _T(matrices: Floats) -> Floats:
    return np.swapaxes(matrices, -1, -2)


def _times(matrices: Floats, vectors: Floats) -> Floats:
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _symmetric(matrices: Floats) -> Floats:
    return np.asarray((matrices + _T(matrices)) / 2)
