"""Whose detection is it? Tracks and the detections of one view, by projected distance."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from tests.reference.filter_sides import exchanged_limbs, order
from tests.reference.filter_update import pixel_variance

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.associate import (
    BIAS_PX,
    COST_LIMIT,
    COST_USUAL,
    JOINT_LIMIT,
    MIN_JOINTS,
    NEVER,
)
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.projection import MIN_DEPTH_M, project


def associate(
    belief: Belief,
    keypoints_px: Floats,
    scores: Floats,
    camera: int,
    model: Model,
    knots_px: Floats,
) -> tuple[Integers, Floats, Integers]:
    """Assign the detections of one view to tracks, at most one each, by the least total cost.

    People who are believed to exist choose first; tracks that are not yet confirmed get what is
    left, so that a false start cannot take a person's detections. The gate grows with the track's
    uncertainty, but of two tracks within it the one that is known better is preferred, as in a
    likelihood: who could be anywhere takes nobody's detection.
    """
    rows = np.full(len(belief), -1, dtype=np.int64)
    fits = np.zeros(len(belief))
    turned = np.zeros(len(belief), dtype=np.int64)
    if len(belief) == 0 or len(scores) == 0:
        return rows, fits, turned
    exchanged = exchanged_limbs(belief, keypoints_px, scores, camera, model, knots_px)
    joints = order(exchanged, model)
    people = np.arange(len(scores))[:, None]
    keypoints, certainty = keypoints_px[people, joints], scores[people, joints]
    cost, vagueness = costs(belief, keypoints, certainty, camera, model, knots_px)
    free = np.ones(len(scores), dtype=bool)
    for group in (belief.confirmed, ~belief.confirmed):
        tracks, people = np.flatnonzero(group), np.flatnonzero(free)
        offered = cost[np.ix_(tracks, people)]
        likely = offered + vagueness[np.ix_(tracks, people)]
        chosen, taken = linear_sum_assignment(np.where(offered <= COST_LIMIT, likely, NEVER))
        good = offered[chosen, taken] <= COST_LIMIT
        rows[tracks[chosen[good]]] = people[taken[good]]
        free[people[taken[good]]] = False
    found = np.flatnonzero(rows >= 0)
    excess = cost[found, rows[found]] - COST_USUAL
    fits[found] = np.clip(1 - excess / (COST_LIMIT - COST_USUAL), 0, 1)
    turned[found] = exchanged[found, rows[found]]
    return rows, fits, turned


def costs(
    belief: Belief,
    keypoints_px: Floats,
    scores: Floats,
    camera: int,
    model: Model,
    knots_px: Floats,
) -> tuple[Floats, Floats]:
    """Return how far tracks and detections are apart, and how vague that is.

    Keypoints and scores are `(num_tracks, num_persons, num_joints, ...)`, as each track takes them.
    """
    pixels, depth, jacobian = project(
        belief.state[..., :3], model.rig.projections[camera : camera + 1]
    )
    spread = pixel_variance(jacobian, belief.covariance[..., :3, :3])[0]
    variance = np.interp(scores, model.noise.scores, knots_px) ** 2
    variance = variance + (BIAS_PX * model.scales[camera]) ** 2
    vague = 0.5 * np.log1p(spread[:, None] / variance)
    variance = variance + spread[:, None]  # (num_tracks, num_persons, num_joints)
    shown = (scores > USED_SCORE) & (depth[0] > MIN_DEPTH_M)[:, None]
    error = np.where(shown[..., None], keypoints_px - pixels[0][:, None], 0.0)
    distance = np.minimum(np.sqrt((error**2).sum(axis=-1) / variance), JOINT_LIMIT)
    weight = np.where(shown, scores, 0.0)
    total = np.maximum(weight.sum(axis=-1), 1e-9)
    mean = (weight * distance).sum(axis=-1) / total
    vagueness = (weight * vague).sum(axis=-1) / total
    return np.where(shown.sum(axis=-1) >= MIN_JOINTS, mean, np.inf), vagueness
