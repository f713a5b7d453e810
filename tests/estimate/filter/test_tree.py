"""The tree of joints against the same least squares solved at once."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.reference.filter_tree import Conditionals, Links, conditionals, solve

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.tree import Tree, grow
from e3pose.model.skeleton import COCO17, SKELETONS, Skeleton


def spd(rng: np.random.Generator, *batch: int) -> Floats:
    """Return random covariances of six dimensions."""
    root = rng.normal(size=(*batch, 6, 9))
    return np.asarray(root @ np.swapaxes(root, -1, -2) / 9)


def random_prior(tree: Tree, rng: np.random.Generator) -> tuple[Floats, Floats, Conditionals]:
    """Return marginals, covariances with the parents, and what they were made of."""
    joints = len(tree.parents)
    own, gains = spd(rng, 1, joints), rng.normal(size=(1, joints, 6, 6)) / 3
    covariance, shared = own.copy(), np.zeros_like(own)
    gains[:, tree.levels[0]] = 0
    for level in tree.levels[1:]:
        parents = tree.parents[level]
        shared[:, level] = gains[:, level] @ covariance[:, parents]
        covariance[:, level] += shared[:, level] @ np.swapaxes(gains[:, level], -1, -2)
    return covariance, shared, Conditionals(gains, own)


def dense(
    tree: Tree, prior: Conditionals, information: Floats, pull: Floats, links: Links
) -> tuple[Floats, Floats]:
    """Return the deviations and the covariance of everything, by one big inverse."""
    joints = len(tree.parents)
    A, b = np.zeros((joints * 6, joints * 6)), pull[0].ravel().copy()
    for joint, parent in enumerate(tree.parents.tolist()):
        rows = slice(6 * joint, 6 * joint + 6)
        A[rows, rows] += information[0, joint]
        between = np.zeros((6, joints * 6))
        between[:, rows] = np.eye(6)
        along = np.zeros(joints * 6)
        along[6 * joint : 6 * joint + 3] = links.along[0, joint]
        if parent >= 0:
            between[:, 6 * parent : 6 * parent + 6] = -prior.gains[0, joint]
            along[6 * parent : 6 * parent + 3] = -links.along[0, joint]
        A += between.T @ np.linalg.inv(prior.covariance[0, joint]) @ between
        A += links.weights[0, joint] * np.outer(along, along)
        b -= links.weights[0, joint] * links.excess_m[0, joint] * along
    covariance = np.linalg.inv(A)
    return np.asarray(covariance @ b), np.asarray(covariance)


@each_case("skeleton", [s for s in SKELETONS.values() if len(s) < 60], ids=lambda s: s.name)
def test_solving_the_tree_is_solving_everything_at_once(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(len(skeleton))
    tree, joints = grow(skeleton), len(skeleton)
    _, _, prior = random_prior(tree, rng)
    information, pull = np.zeros((1, joints, 6, 6)), np.zeros((1, joints, 6))
    information[..., :3, :3] = spd(rng, 1, joints)[..., :3, :3]
    information[:, ::3] = 0  # joints that nobody saw
    pull[..., :3] = rng.normal(size=(1, joints, 3))
    along = rng.normal(size=(1, joints, 3))
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    weights = rng.uniform(0, 30, (1, joints)) * (rng.uniform(size=(1, joints)) < 0.7)
    weights[:, tree.levels[0]] = 0
    links = Links(along, rng.normal(size=(1, joints)), weights)
    moved, covariance, shared = solve(tree, prior, information, pull, links)
    expected, everything = dense(tree, prior, information, pull, links)
    np.testing.assert_allclose(moved.ravel(), expected, atol=1e-9)
    blocks = everything.reshape(joints, 6, joints, 6)
    for joint, parent in enumerate(tree.parents.tolist()):
        np.testing.assert_allclose(covariance[0, joint], blocks[joint, :, joint], atol=1e-9)
        if parent >= 0:
            np.testing.assert_allclose(shared[0, joint], blocks[joint, :, parent], atol=1e-9)


def test_conditionals_undo_marginals() -> None:
    tree = grow(COCO17)
    covariance, shared, made_of = random_prior(tree, np.random.default_rng(0))
    found = conditionals(tree, covariance, shared)
    np.testing.assert_allclose(found.gains, made_of.gains, atol=1e-9)
    np.testing.assert_allclose(found.covariance, made_of.covariance, atol=1e-9)


@each_case("skeleton", SKELETONS.values(), ids=lambda s: s.name)
def test_every_skeleton_grows_one_tree(skeleton: Skeleton) -> None:
    tree = grow(skeleton)
    assert (tree.parents < 0).sum() == 1
    assert sorted(np.concatenate(tree.levels).tolist()) == list(range(len(skeleton)))
    for upper, level in zip(tree.levels, tree.levels[1:], strict=False):
        assert np.isin(tree.parents[level], upper).all()
    root = tree.levels[0][0]
    assert (tree.drift_m2ps4 > 0).all() and (tree.lasts_s[root] >= tree.lasts_s).all()


def test_arms_hang_on_the_shoulders_of_their_side() -> None:
    names, parents = COCO17.joints, grow(COCO17).parents
    for side in ("left", "right"):
        chain = [names.index(f"{side}_{part}") for part in ("wrist", "elbow", "shoulder")]
        assert parents[chain[:2]].tolist() == chain[1:]
