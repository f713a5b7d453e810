"""Solve the tree of a body: what `filter.tree` finds, by a block Cholesky factorisation.

The prior of a tree is a sum of squares over joints and their parents, so its information matrix has
a 6 x 6 block for each joint and one for each joint with its parent. Eliminating the joints from the
leaves to the root fills in no other block. Blocks are rows of `(num_joints, 36)`; of those that
are symmetric, and of Cholesky factors, which have the reciprocals of their diagonal on it, only the
lower halves are read.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


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
    """Write the covariances after `eliminate`; what it left in `across` is lost."""
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
