"""Predict and update: one Kalman filter per person, measured directly by pixels of any views."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tests.reference import filter_bias, filter_proportions
from tests.reference.filter_motion import spread
from tests.reference.filter_tree import Links, conditionals, solve

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS, OUTLIER_SIGMAS
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.proportions import BONE_MEMORY, BONE_TEACHERS
from e3pose.estimate.filter.state import Belief, Model
from e3pose.estimate.filter.update import (
    BONE_KNOWN_M,
    ITERATIONS,
    USUAL_SLACK_M,
)
from e3pose.model.projection import MIN_DEPTH_M, project


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The views of one slot, sorted by track.

    Attributes:
        projections: `(num_views, 3, 4)`.
        keypoints_px: `(num_views, num_tracks, num_joints, 2)` undistorted, NaN where not seen.
        scores: `(num_views, num_tracks, num_joints)`, 0 where not seen.
        sigma_px: the expected error of each, of the same shape.
        look: `(num_views, num_tracks, 1)` factor on it for what the look before said already.
    """

    projections: Floats
    keypoints_px: Floats
    scores: Floats
    sigma_px: Floats
    look: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """A view of an unchanged image, sorted by track.

    Attributes:
        camera: index of the camera.
        scores: `(num_tracks, num_joints)`, 0 where not seen.
        pace_px: how fast joints may move all the same, per second.
        free_px: `(num_free, num_joints, 2)` of the people whom no track explains.
        free_scores: `(num_free, num_joints)` of these.
    """

    camera: int
    scores: Floats
    pace_px: float
    free_px: Floats
    free_scores: Floats


def predict(belief: Belief, dt: float, model: Model) -> Belief:
    """Return the belief `dt` seconds later, before anything is seen."""
    covariance, shared = spread(
        model.tree, belief.covariance, belief.shared, belief.drift_share, dt
    )
    return replace(
        belief,
        state=places(model.tree, belief.state, dt),
        covariance=covariance,
        shared=shared,
        unmeasured_s=belief.unmeasured_s + dt,
        bias_px=filter_bias.fade(belief.bias_px, dt, memory_terms(model.noise.memory)),
    )


def pixel_variance(jacobian: Floats, covariance_m2: Floats) -> Floats:
    """Return the mean variance of a projected point's two coordinates: `(num_views, *batch)`."""
    spread: Floats = np.einsum("...ab,...bc,...ac->...", jacobian, covariance_m2, jacobian)
    return spread / 2


def update(belief: Belief, seen: Sightings, stills: list[Still], model: Model) -> Belief:
    """Return the belief after the views of a slot: robust, iterated, all tracks and joints at once.

    Each pass minimises the squared distance to the prediction, to the keypoints and to the learned
    bone lengths, in units of their standard deviations; a keypoint's weight falls with its error.
    """
    if len(belief) == 0:
        return belief
    measured = np.zeros(belief.unmeasured_s.shape, dtype=bool)
    if len(seen.projections) or stills:
        prior = conditionals(model.tree, belief.covariance, belief.shared)
        lengths = _lengths(belief, model)
        moved = np.zeros_like(belief.state)
        for iteration in range(ITERATIONS):
            state = belief.state + moved
            pixels, depth, jacobian = project(state[..., :3], seen.projections)
            usable = (seen.scores > USED_SCORE) & (depth > MIN_DEPTH_M)
            error = np.where(usable[..., None], seen.keypoints_px - pixels, 0.0)
            variance = (seen.sigma_px * seen.look) ** 2
            doubt = pixel_variance(jacobian, belief.covariance[..., :3, :3])
            off = (error**2).sum(axis=-1) / (variance + (doubt if iteration == 0 else 0.0))
            weight = np.where(usable, 1 / (1 + off / OUTLIER_SIGMAS**2) / variance, 0.0)
            measured |= (usable & (off < MEASURED_SIGMAS**2)).any(axis=0)
            error += (jacobian @ moved[..., :3, None])[..., 0]  # from the prediction
            information, pull = np.zeros_like(belief.covariance), np.zeros_like(moved)
            information[..., :3, :3] = np.einsum(
                "v...,v...ab,v...ac->...bc", weight, jacobian, jacobian
            )
            pull[..., :3] = np.einsum("v...,v...ab,v...a->...b", weight, jacobian, error)
            for still in stills:
                measured |= _pull_still(
                    belief, moved, still, iteration == 0, information, pull, model
                )
            _pull_bones(belief, moved, seen, lengths, information, pull, model)
            links = _links(belief, moved, lengths, model)
            moved, covariance, shared = solve(model.tree, prior, information, pull, links)
        belief = replace(belief, state=belief.state + moved, covariance=covariance, shared=shared)
    return replace(belief, unmeasured_s=np.where(measured, 0.0, belief.unmeasured_s))


def _pull_still(
    belief: Belief,
    moved: Floats,
    still: Still,
    first: bool,
    information: Floats,
    pull: Floats,
    model: Model,
) -> Flags:
    """Add what an unchanged image tells of velocities; return which joints it measures."""
    state = belief.state + moved
    projection = model.rig.projections[still.camera]
    _, depths, jacobians = project(state[..., :3], projection[None])
    jacobian = jacobians[0]
    usable = (still.scores > USED_SCORE) & (depths[0] > MIN_DEPTH_M)
    error = np.where(usable[..., None], -(jacobian @ state[..., 3:, None])[..., 0], 0.0)
    variance = still.pace_px**2
    doubt = pixel_variance(jacobian, belief.covariance[..., 3:, 3:]) if first else 0.0
    off = (error**2).sum(axis=-1) / (variance + doubt)
    weight = np.where(usable, 1 / (1 + off / OUTLIER_SIGMAS**2) / variance, 0.0)
    error += (jacobian @ moved[..., 3:, None])[..., 0]  # from the prediction
    information[..., 3:, 3:] += np.einsum("...,...ab,...ac->...bc", weight, jacobian, jacobian)
    pull[..., 3:] += np.einsum("...,...ab,...a->...b", weight, jacobian, error)
    return np.asarray(usable & (off < MEASURED_SIGMAS**2))


def learn_biases(
    belief: Belief, seen: Sightings, cameras: Integers, dt: float, model: Model
) -> Belief:
    """Return the belief after each view of a slot was compared with the updated people."""
    biases, terms = belief.bias_px.copy(), memory_terms(model.noise.memory)
    pixels, depth, jacobian = project(belief.state[..., :3], seen.projections)
    usable = (seen.scores > USED_SCORE) & (depth > MIN_DEPTH_M)
    error = np.where(usable[..., None], seen.keypoints_px - pixels, 0.0)
    doubt = pixel_variance(jacobian, belief.covariance[..., :3, :3])
    for view, camera in enumerate(cameras.tolist()):
        since_s = belief.last_seen_s[:, camera] + dt
        biases[:, camera] = filter_bias.learn(
            biases[:, camera], error[view], seen.sigma_px[view], doubt[view], since_s, terms
        )
    return replace(belief, bias_px=biases)


def size_variances(belief: Belief, model: Model) -> Floats:
    """Return `(num_tracks,)` of the logarithms of people's sizes."""
    rows = zip(belief.bones_m, belief.bone_counts, strict=True)
    return np.array([filter_proportions.expect(*row, model.proportions)[2] for row in rows])


def _lengths(belief: Belief, model: Model) -> tuple[Floats, Floats]:
    """Return lengths and slacks of bones, `(num_tracks, num_bones)`; a slack of inf for unknown."""
    body = model.proportions
    lengths_m, slacks_m = belief.bones_m.copy(), np.zeros_like(belief.bones_m)
    limb = body.kinds >= 0
    for track, learned in enumerate(zip(belief.bones_m, belief.bone_counts, strict=True)):
        expected_m, variances, _ = filter_proportions.expect(*learned, body)
        lengths_m[track, limb] = expected_m[limb]
        slacks_m[track] = np.sqrt(body.slacks_m**2 + variances * expected_m**2)
    unknown = ~limb & (belief.bone_counts <= BONE_TEACHERS)
    return lengths_m, np.where(unknown, np.inf, slacks_m)


def _links(belief: Belief, moved: Floats, lengths: tuple[Floats, Floats], model: Model) -> Links:
    """Return the bones within the tree, which are solved together with it."""
    parents, rows = np.maximum(model.tree.parents, 0), model.proportions.links
    state = belief.state + moved
    between = state[..., :3] - state[:, parents, :3]
    length = np.maximum(np.linalg.norm(between, axis=-1), 1e-6)
    along = between / length[..., None]
    turned = ((moved[..., :3] - moved[:, parents, :3]) * along).sum(axis=-1)
    usual_m = np.broadcast_to(model.tree.usual_m, length.shape)
    held = np.flatnonzero(rows >= 0)
    lengths_m, slacks_m = (each[:, rows[held]] for each in lengths)
    known = np.isfinite(slacks_m)
    excess = length - usual_m - turned
    weights = np.where(usual_m > 0, 1 / USUAL_SLACK_M**2, 0.0)
    excess[:, held] = np.where(
        known, length[:, held] - lengths_m - turned[:, held], excess[:, held]
    )
    weights[:, held] = np.where(known, 1 / slacks_m**2, weights[:, held])
    return Links(along, excess, weights)


def _pull_bones(
    belief: Belief,
    moved: Floats,
    seen: Sightings,
    lengths: tuple[Floats, Floats],
    information: Floats,
    pull: Floats,
    model: Model,
) -> None:
    """Add what bones across the tree say to either end, which takes the other as fixed.

    Only of people whom a view shows: for the others two joints would make each other surer of
    where they are, slot by slot, without anybody having looked.
    """
    across = np.setdiff1d(np.arange(len(model.proportions.bones)), model.proportions.links)
    first, second = model.proportions.bones[across].T
    state = belief.state + moved
    apart = state[:, first, :3] - state[:, second, :3]  # (num_tracks, num_bones, 3)
    length = np.maximum(np.linalg.norm(apart, axis=-1), 1e-6)
    along = apart / length[..., None]
    lengths_m, slacks_m = (each[:, across] for each in lengths)
    excess = length - lengths_m
    trusted = np.asarray((seen.scores > 0).any(axis=(0, 2)))[:, None]
    outer = along[..., :, None] * along[..., None, :]
    rows = np.arange(len(belief))[:, None]
    for end, other, sign in ((first, second, 1.0), (second, first, -1.0)):
        spread = np.einsum("tba,tbac,tbc->tb", along, belief.covariance[:, other, :3, :3], along)
        weight = np.where(trusted, 1 / (spread / 2 + slacks_m**2), 0.0)
        gone = (moved[:, end, :3] * along).sum(axis=-1)
        np.add.at(information[..., :3, :3], (rows, end), weight[..., None, None] * outer)
        np.add.at(pull[..., :3], (rows, end), (weight * (gone - sign * excess))[..., None] * along)


def learn_bones(belief: Belief, model: Model) -> Belief:
    """Return the belief after joints that are well known taught how far apart they are."""
    first, second = model.proportions.bones.T
    spread = np.trace(belief.covariance[..., :3, :3], axis1=-2, axis2=-1)
    known = spread < 3 * BONE_KNOWN_M**2
    fresh = belief.unmeasured_s == 0
    teaches = (known & fresh)[:, first] & (known & fresh)[:, second]
    length = np.linalg.norm(belief.state[:, first, :3] - belief.state[:, second, :3], axis=-1)
    count = np.minimum(belief.bone_counts, BONE_MEMORY)
    mean = (belief.bones_m * count + length) / (count + 1)
    return replace(
        belief,
        bones_m=np.where(teaches, mean, belief.bones_m),
        bone_counts=np.where(teaches, count + 1, belief.bone_counts),
    )
