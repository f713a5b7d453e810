"""Left or right? Detectors exchange the sides of arms, of legs or of whole people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tests.reference.filter_update import pixel_variance

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.existence import LEARN_RATE
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.sides import (
    APART_S,
    ARMS,
    ARMS_ODDS,
    BOTH_ODDS,
    GIVEN,
    LEGS,
    LEGS_ODDS,
    PAIR_ODDS,
    SIDE_PX,
)
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.projection import MIN_DEPTH_M, project


def exchanged_limbs(
    belief: Belief,
    keypoints_px: Floats,
    scores: Floats,
    camera: int,
    model: Model,
    knots_px: Floats,
) -> Integers:
    """Return `(num_tracks, num_persons)`: bits of the limbs exchanged, and of those as given.

    Arguments are those of `associate`.
    """
    opposites, limbs = model.sides
    pixels, depth, jacobian = project(
        belief.state[..., :3], model.rig.projections[camera : camera + 1]
    )
    spread = pixel_variance(jacobian, belief.covariance[..., :3, :3])[0][:, None]
    in_front = (depth[0] > MIN_DEPTH_M)[:, None]
    in_front = in_front & in_front[..., opposites]
    predicted = pixels[0][:, None]
    across = predicted - predicted[..., opposites, :]
    middle = (predicted + predicted[..., opposites, :]) / 2
    variance = np.interp(scores, model.noise.scores, knots_px)[None] ** 2
    variance = variance + (SIDE_PX * model.scales[camera]) ** 2
    shown = scores[None] > USED_SCORE
    both = shown & shown[..., opposites]
    found = np.where(shown[..., None], keypoints_px[None], 0.0)
    pair = 2 * ((found - found[..., opposites, :]) * across).sum(axis=-1)
    pair /= variance + variance[..., opposites] + spread + spread[..., opposites]
    one = ((found - middle) * across).sum(axis=-1)
    one /= variance + (spread + spread[..., opposites]) / 2
    counts = shown & in_front & (~both | (np.arange(len(opposites)) < opposites))
    odds = np.clip(np.where(both, pair, one), -PAIR_ODDS, PAIR_ODDS)
    arms, legs = (np.where(counts & (limbs == limb), odds, 0.0).sum(-1) for limb in (ARMS, LEGS))
    choices = np.stack(
        [np.zeros_like(arms), -arms - ARMS_ODDS, -legs - LEGS_ODDS, -arms - legs - BOTH_ODDS]
    )
    exchanged = choices.argmax(axis=0)
    for limb, known in ((ARMS, arms > ARMS_ODDS), (LEGS, legs > ARMS_ODDS)):
        exchanged += np.where(known & (exchanged & limb == 0), GIVEN * limb, 0)
    return np.asarray(exchanged, dtype=np.int64)


def order(exchanged: Integers, model: Model) -> Integers:
    """Return `(*batch, num_joints)`: where each joint of a detection is to be found."""
    opposites, limbs = model.sides
    turned = (exchanged[..., None] & limbs) > 0
    return np.where(turned, opposites, np.arange(len(opposites)))


def turn_round(
    belief: Belief,
    exchanged: Integers,
    hits: NDArray[np.bool_],
    cameras: Integers,
    dt: float,
    model: Model,
) -> tuple[Belief, Integers]:
    """Return the belief with the sides of contradicted tracks exchanged, and what is left."""
    opposites, limbs = model.sides
    mirrored, exchanged = belief.mirrored.copy(), exchanged.copy()
    state, bias_px = belief.state.copy(), belief.bias_px.copy()
    for row, limb in enumerate((ARMS, LEGS)):
        share = mirrored[:, row]
        for view, camera in enumerate(cameras.tolist()):
            evidence = hits[view] & (exchanged[view] & (limb + GIVEN * limb) > 0)
            since = np.minimum((belief.last_seen_s[:, camera] + dt) / APART_S, 1.0)
            rate = np.where(evidence, LEARN_RATE * since, 0.0)
            share = share + rate * ((exchanged[view] & limb > 0) - share)
        turned = share > 0.5
        mirrored[:, row] = np.where(turned, 1 - share, share)
        joints = limbs == limb
        both = np.ix_(turned, joints)
        state[both] = belief.state[np.ix_(turned, opposites[joints])]
        moved = bias_px[turned]
        moved[:, :, joints] = 0.0
        bias_px[turned] = moved
        known = exchanged & (limb + GIVEN * limb) > 0
        exchanged = np.where(turned & known, exchanged ^ limb, exchanged)
    return replace(belief, state=state, bias_px=bias_px, mirrored=mirrored), exchanged
