"""The body as a tree: what is learned about one joint tells about its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.tree import (
    Tree,
)


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
