"""The body as a tree: correlations between neighbouring joints.

A person is a Gaussian tree. Given its parent, a joint does not depend on the rest of the body:

    x_j | x_p ~ N(m_j + G_j (x_p - m_p), S_j),   G_j = C_j P_p^-1,   S_j = P_j - G_j C_j'

with m and P the mean and covariance of a joint's position and velocity, and C_j its covariance with
its parent. Keypoints inform single joints and bones pairs of neighbours, so the posterior is a tree
again, exact in one pass from the leaves to the root and one back (Pearl's belief propagation). Over
time the marginals and the C_j are carried: of all trees the one nearest to the true distribution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.model.skeleton import Skeleton


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


# tuned: m/s2, s | motion capture and simulated, lab/experiments/2026-11-22-lag.md | 20 % more: 1 to
#   2 % worse by the truth; less was not tried
TRUNK, STIFF = Habit(4.3, 0.78), Habit(2.9, 0.4)  # the body; spine, girdles and head


# tuned: m/s2, s | motion capture and simulated, lab/experiments/2026-11-22-lag.md | 20 % more: 1 to
#   2 % worse by the truth
MIDDLE, END = Habit(6.2, 0.25), Habit(8.2, 0.2)  # elbows and knees; wrists and ankles


# A foot turns as CMU's motion capture does beside the ankle, by the distance from it, half as
# strongly again, as the ankle's habit is to CMU's. Their bones are too short to be learned; usual
# lengths keep feet near ankles that are better known than they, as feet are seen less often.
# tuned: m/s2, s, m | CMU motion capture, half as strong again | one habit of feet
TOE = Habit(9.0, 0.15, usual_m=0.2)


# tuned: m/s2, s, m | CMU motion capture, half as strong again | one habit of feet
SMALL_TOE = Habit(4.0, 0.15, usual_m=0.09)


# tuned: m/s2, s, m | CMU motion capture, half as strong again | one habit of feet
HEEL = Habit(3.5, 0.15, usual_m=0.08)


# Fingers move as small toes do, faces as heads; how far they are, skeletons say (`rest_m`).
HABITS = {
    "trunk": TRUNK, "stiff": STIFF, "face": STIFF, "middle": MIDDLE, "end": END, "toe": TOE,
    "small_toe": SMALL_TOE, "heel": HEEL, "finger": SMALL_TOE._replace(usual_m=0.0), "skin": STIFF,
}  # fmt: skip


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

    parents: Integers
    levels: tuple[Integers, ...]
    order: Integers
    drift_m2ps4: Floats
    lasts_s: Floats
    usual_m: Floats


def grow(skeleton: Skeleton) -> Tree:
    """Return the tree of a skeleton."""
    parents = list(skeleton.parents)
    habits = np.array([HABITS[how] for how in skeleton.moves])
    order = [parents.index(-1)]
    habits[order] = TRUNK
    if {*skeleton.moves} == {"finger"}:  # a wrist takes part in what all joints above it do
        arm = np.array([TRUNK, STIFF, MIDDLE, END])
        power = arm[:, 0] ** 2
        habits[order, :2] = np.sqrt(power.sum()), power @ arm[:, 1] / power.sum()
    for joint in order:
        order.extend(child for child, parent in enumerate(parents) if parent == joint)
    depth = np.zeros(len(parents), dtype=np.int64)
    for joint in order[1:]:
        depth[joint] = depth[parents[joint]] + 1
    levels = tuple(np.flatnonzero(depth == d) for d in range(depth.max() + 1))
    lasts_s, usual_m = np.ascontiguousarray(habits[:, 1:].T)
    rest_m = np.linalg.norm(np.array(skeleton.rest_m).reshape(-1, 3), axis=1)
    if len(rest_m):
        usual_m = np.where(np.isfinite(rest_m), rest_m, usual_m)
    return Tree(
        np.array(parents, dtype=np.int64),
        levels,
        np.concatenate(levels),
        habits[:, 0] ** 2,
        lasts_s,
        usual_m,
    )


@kernel
def prepare(
    order: Integers,
    parents: Integers,
    covariance: Floats,
    shared: Floats,
    own: Floats,
    across: Floats,
    factors: Floats,
    room: Floats,
) -> None:
    """Write the information of the prior of one track to `own` and `across`.

    Args:
        order: `(num_joints,)` the root first, each joint after its parent.
        parents: `(num_joints,)`, -1 at the root.
        covariance: of each joint.
        shared: of each joint with its parent.
        own: filled, of each joint.
        across: filled, of each joint with its parent.
        factors: scratch, `(num_joints, 36)`.
        room: scratch, `(3, 36)`.
    """
    for place in range(len(order)):
        joint = order[place]
        for entry in range(36):
            factors[joint, entry] = covariance[joint, entry]
            own[joint, entry] = 0.0
            across[joint, entry] = 0.0
        decompose(factors[joint])
        parent = parents[joint]
        if parent < 0:
            _invert(factors[joint], room[0])
            _add_square(room[0], own[joint])
            continue
        # Given its parent a joint is N(G x_p, S), with G the transpose of the solution here.
        for a in range(6):
            for b in range(6):
                room[0, 6 * a + b] = shared[joint, 6 * b + a]
        forward(factors[parent], room[0])
        backward(factors[parent], room[0])
        for a in range(6):
            for b in range(a + 1):
                total = covariance[joint, 6 * a + b]
                for k in range(6):
                    total -= room[0, 6 * k + a] * shared[joint, 6 * b + k]
                room[1, 6 * a + b] = total
        decompose(room[1])
        _invert(room[1], room[2])
        _add_square(room[2], own[joint])
        for a in range(6):
            for b in range(6):
                across[joint, 6 * a + b] = -room[0, 6 * b + a]
        forward(room[1], across[joint])
        _add_square(across[joint], own[parent])
        backward(room[1], across[joint])


@kernel
def eliminate(
    order: Integers, parents: Integers, own: Floats, across: Floats, pull: Floats, moved: Floats
) -> None:
    """Write the least-squares positions of all joints to `moved`.

    `own` becomes the factor L of each joint, `across` L^-1 times what it was; `pull` and `moved`
    are `(num_joints, 6)`.
    """
    for place in range(len(order) - 1, -1, -1):
        joint = order[place]
        parent = parents[joint]
        decompose(own[joint])
        for a in range(6):
            total = pull[joint, a]
            for k in range(a):
                total -= own[joint, 6 * a + k] * pull[joint, k]
            pull[joint, a] = total * own[joint, 7 * a]
        if parent < 0:
            break
        forward(own[joint], across[joint])
        for k in range(6):
            for a in range(6):
                factor = across[joint, 6 * k + a]
                for b in range(a + 1):
                    own[parent, 6 * a + b] -= factor * across[joint, 6 * k + b]
                pull[parent, a] -= factor * pull[joint, k]
    for place in range(len(order)):
        joint = order[place]
        parent = parents[joint]
        for a in range(5, -1, -1):
            total = pull[joint, a]
            if parent >= 0:
                for k in range(6):
                    total -= across[joint, 6 * a + k] * moved[parent, k]
            for k in range(a + 1, 6):
                total -= own[joint, 6 * k + a] * moved[joint, k]
            moved[joint, a] = total * own[joint, 7 * a]


@kernel
def spread_out(
    order: Integers,
    parents: Integers,
    own: Floats,
    across: Floats,
    covariance: Floats,
    shared: Floats,
    room: Floats,
) -> None:
    """Write the covariances after `eliminate`; overwrites `across`."""
    for place in range(len(order)):
        joint = order[place]
        parent = parents[joint]
        _invert(own[joint], room[0])
        for entry in range(36):
            room[1, entry] = 0.0
        _add_square(room[0], room[1])
        if parent >= 0:
            backward(own[joint], across[joint])
            for a in range(6):
                for b in range(6):
                    total = 0.0
                    for k in range(6):
                        total -= across[joint, 6 * a + k] * covariance[parent, 6 * k + b]
                    shared[joint, 6 * a + b] = total
            for a in range(6):
                for b in range(a + 1):
                    total = room[1, 6 * a + b]
                    for k in range(6):
                        total -= shared[joint, 6 * a + k] * across[joint, 6 * b + k]
                    room[1, 6 * a + b] = total
        for a in range(6):
            for b in range(a + 1):
                covariance[joint, 6 * a + b] = room[1, 6 * a + b]
                covariance[joint, 6 * b + a] = room[1, 6 * a + b]


@kernel
def decompose(block: Floats) -> None:
    """Replace the lower half of a block by its Cholesky factor."""
    for a in range(6):
        for b in range(a):
            total = block[6 * a + b]
            for k in range(b):
                total -= block[6 * a + k] * block[6 * b + k]
            block[6 * a + b] = total * block[7 * b]
        total = block[7 * a]
        for k in range(a):
            total -= block[6 * a + k] ** 2
        block[7 * a] = 1.0 / math.sqrt(total)


@kernel
def forward(factor: Floats, block: Floats) -> None:
    """Multiply a block by L^-1 from the left.

    A row is six variables, which stay in registers: an array is written and read again for every
    k, and takes 1.6 times as long.
    """
    for a in range(6):
        at = 6 * a
        x0, x1, x2 = block[at], block[at + 1], block[at + 2]
        x3, x4, x5 = block[at + 3], block[at + 4], block[at + 5]
        for k in range(a):
            s, o = factor[6 * a + k], 6 * k
            x0, x1, x2 = x0 - s * block[o], x1 - s * block[o + 1], x2 - s * block[o + 2]
            x3, x4, x5 = x3 - s * block[o + 3], x4 - s * block[o + 4], x5 - s * block[o + 5]
        s = factor[7 * a]
        block[at], block[at + 1], block[at + 2] = x0 * s, x1 * s, x2 * s
        block[at + 3], block[at + 4], block[at + 5] = x3 * s, x4 * s, x5 * s


@kernel
def backward(factor: Floats, block: Floats) -> None:
    """Multiply a block by the transpose of L^-1 from the left; rows as in `forward`."""
    for a in range(5, -1, -1):
        at = 6 * a
        x0, x1, x2 = block[at], block[at + 1], block[at + 2]
        x3, x4, x5 = block[at + 3], block[at + 4], block[at + 5]
        for k in range(a + 1, 6):
            s, o = factor[6 * k + a], 6 * k
            x0, x1, x2 = x0 - s * block[o], x1 - s * block[o + 1], x2 - s * block[o + 2]
            x3, x4, x5 = x3 - s * block[o + 3], x4 - s * block[o + 4], x5 - s * block[o + 5]
        s = factor[7 * a]
        block[at], block[at + 1], block[at + 2] = x0 * s, x1 * s, x2 * s
        block[at + 3], block[at + 4], block[at + 5] = x3 * s, x4 * s, x5 * s


@kernel
def _invert(factor: Floats, block: Floats) -> None:
    """Write L^-1, zeros above the diagonal included."""
    for a in range(6):
        for b in range(6):
            block[6 * a + b] = 1.0 if a == b else 0.0
    forward(factor, block)


@kernel
def _add_square(block: Floats, total: Floats) -> None:
    """Add B' B to the lower half of `total`."""
    for k in range(6):
        for a in range(6):
            for b in range(a + 1):
                total[6 * a + b] += block[6 * k + a] * block[6 * k + b]
