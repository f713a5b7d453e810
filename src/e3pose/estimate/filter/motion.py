"""Motion model: each joint relative to its parent, the root in the world.

    x_j' = x_p' + R_j (x_j - x_p) + w_j,    R = [1, tau (1 - exp(-dt / tau)); 0, exp(-dt / tau)]

A person who walks keeps on walking: the root's velocity lasts. What a limb does beside the body
turns round within a quarter of a second, and sooner the farther out it is; so a foot that nobody
sees soon goes with the body. The noise w is that of a velocity with a life of tau, exactly: short
steps add up to what one long step says.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.tree import Tree
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import motion as kernels
else:
    kernels = Deferred("e3pose.estimate.filter.kernels.motion")

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ACCELERATION_LASTS_S = 1 / 25  # definition: those of `tree` are drawn anew so often


def places(tree: Tree, state: Floats, dt: float) -> Floats:
    """Return the state `dt` seconds later.

    Args:
        tree: of the skeleton.
        state: `(num_tracks, num_joints, 6)` metres, metres per second.
        dt: seconds, 0 or more.
    """
    moved = np.empty_like(state, order="C")
    kernels.move_all(
        float(dt),
        tree.order,
        tree.parents,
        tree.lasts_s,
        np.ascontiguousarray(state),
        moved,
    )
    return moved


def alone(tree: Tree) -> tuple[Floats, Floats]:
    """Return each joint's motion in the world as one process, independent of other joints.

    It takes part in what all joints above it do. Its velocity lasts as long as theirs do, by their
    share of the noise.

    Returns:
        `(num_joints,)` power density of the acceleration along an axis, m2/s3, and `(num_joints,)`
        seconds until a velocity is down to 1/e.
    """
    own = ACCELERATION_LASTS_S * tree.drift_m2ps4
    total, lasting = own.copy(), own * tree.lasts_s
    for level in tree.levels[1:]:
        total[level] += total[tree.parents[level]]
        lasting[level] += lasting[tree.parents[level]]
    return total, lasting / total


def fading(density_m2ps3: Floats, lasts_s: Floats, dt: float) -> tuple[Floats, Floats]:
    """Return R and the covariance of w along one axis, `(*batch, 2, 2)` each.

    Args:
        density_m2ps3: `(*batch)` power density of the acceleration.
        lasts_s: `(*batch)` until a velocity is down to 1/e.
        dt: seconds, 0 or more.
    """
    tau = lasts_s
    fade = np.exp(-dt / tau)
    gone = 1 - fade
    step = np.array([[np.ones_like(tau), tau * gone], [np.zeros_like(tau), fade]])
    pp = tau**2 * (dt - 2 * tau * gone + tau * (1 - fade**2) / 2)
    pv, vv = (tau * gone) ** 2 / 2, tau * (1 - fade**2) / 2
    noise: Floats = np.array([[pp, pv], [pv, vv]]) * density_m2ps3
    R = np.moveaxis(step, (0, 1), (-2, -1))
    W = np.moveaxis(noise, (0, 1), (-2, -1))
    return np.asarray(R, dtype=np.float64), np.asarray(W, dtype=np.float64)


def transitions(tree: Tree, level: Ints, dt: float) -> tuple[Floats, Floats]:
    """Return R and the covariance of w of joints, `(num_joints_of_level, 6, 6)` each.

    Args:
        tree: of the skeleton.
        level: `(num_joints_of_level,)` the joints.
        dt: seconds, 0 or more.
    """
    density = ACCELERATION_LASTS_S * tree.drift_m2ps4[level]
    step, noise = fading(density, tree.lasts_s[level], dt)
    R, W = (np.asarray(np.kron(each, np.eye(3)), dtype=np.float64) for each in (step, noise))
    return R, W
