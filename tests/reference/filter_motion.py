"""How a body moves while nobody looks: each joint beside its parent, the root in the world."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.motion import ACCELERATION_LASTS_S
from e3pose.estimate.filter.tree import Tree


def spread(
    tree: Tree, covariance: Floats, shared: Floats, drift_share: Floats, dt: float
) -> tuple[Floats, Floats]:
    """Return the covariance `dt` seconds later and that of each joint with its parent.

    With Z the covariance of a joint now with the same joint then, and G as in `tree`:

        L = R_j (G_j - 1) Z_p,    P_j' = R_j (P_j - C_j - C_j' + P_p) R_j' + L + L' + P_p' + W_j,
        C_j' = L + P_p',    Z_j = (P_j - C_j) R_j' + G_j Z_p
    """
    after, with_parent = np.empty_like(covariance), np.zeros_like(shared)
    across = np.empty_like(covariance)  # Z
    eye = np.eye(6)
    for level in tree.levels:
        R, W = _transitions(tree, level, dt)
        W = W * drift_share[:, level, None, None]
        RT = np.swapaxes(R, -1, -2)
        parents = tree.parents[level]
        if parents[0] < 0:
            across[:, level] = covariance[:, level] @ RT
            after[:, level] = R @ across[:, level] + W
            continue
        P, C, above = covariance[:, level], shared[:, level], covariance[:, parents]
        CT = np.swapaxes(C, -1, -2)
        gains = np.swapaxes(np.linalg.solve(above, CT), -1, -2)
        lean = R @ ((gains - eye) @ across[:, parents])
        across[:, level] = (P - C) @ RT + gains @ across[:, parents]
        after[:, level] = R @ (P - C - CT + above) @ RT + lean + np.swapaxes(lean, -1, -2)
        after[:, level] += after[:, parents] + W
        with_parent[:, level] = lean + after[:, parents]
    return after, with_parent


def _transitions(tree: Tree, level: Integers, dt: float) -> tuple[Floats, Floats]:
    """Return R and the covariance of w, `(num_joints_of_level, 6, 6)` each."""
    tau = tree.lasts_s[level]
    fade = np.exp(-dt / tau)
    gone = 1 - fade
    step = np.array([[np.ones_like(tau), tau * gone], [np.zeros_like(tau), fade]])
    pp = tau**2 * (dt - 2 * tau * gone + tau * (1 - fade**2) / 2)
    pv, vv = (tau * gone) ** 2 / 2, tau * (1 - fade**2) / 2
    noise = np.array([[pp, pv], [pv, vv]]) * (ACCELERATION_LASTS_S * tree.drift_m2ps4[level])
    R, W = (np.kron(np.moveaxis(each, -1, 0), np.eye(3)) for each in (step, noise))
    return R, W
