"""Who is shown, and steering, in plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.reference.filter_blindness import proof
from tests.reference.filter_motion import places

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter.blindness import PLAIN
from e3pose.estimate.filter.estimator import GAIN
from e3pose.estimate.filter.shown import LEAVES_HZ, SHOWN_SPREAD_M
from e3pose.estimate.filter.state import Belief, Model
from e3pose.estimate.filter.tree import Tree


def left_odds(belief: Belief, model: Model) -> Floats:
    """See `kernels.shown.left_odds`."""
    odds = np.zeros(len(belief))
    unseen_s = belief.last_seen_s.min(axis=1, initial=np.inf)
    lost = np.flatnonzero(unseen_s > 0)
    if len(lost) == 0:
        return odds
    places_m = belief.state[lost, model.tree.levels[0][0], :2]
    cameras = np.arange(len(model.rig))
    proofs = proof(belief.detection_map, cameras, places_m, model.corner_m)
    misses = (belief.missed[lost] * proofs.T).sum(axis=1)  # as many as these in plain sight
    odds[lost] = LEAVES_HZ * unseen_s[lost] * (1 - PLAIN) ** -misses
    return odds


def shown(belief: Belief, model: Model) -> Flags:
    """See `e3pose.estimate.filter.shown.shown`."""
    trace = np.trace(belief.covariance[..., :3, :3], axis1=-2, axis2=-1)
    certain = np.sqrt(trace.min(axis=-1)) < SHOWN_SPREAD_M
    there = left_odds(belief, model) < 1.0
    return np.asarray(belief.confirmed & certain & there)


def steer(
    tree: Tree,
    belief: Belief,
    rows: Integers,
    joints_m: Floats,
    ahead_s: float,
    drift_share: Floats | float = 1.0,
) -> Belief:
    """See `e3pose.estimate.filter.estimator.steer`."""
    shares = np.ones_like(belief.drift_share)
    if ahead_s <= 0 or not np.isfinite(joints_m).any():
        return replace(belief, drift_share=shares)
    reach_s = (tree.lasts_s * (1 - np.exp(-ahead_s / tree.lasts_s)))[:, None]
    expected_m = places(tree, belief.state[rows], ahead_s)[..., :3]
    apart = GAIN * (joints_m - expected_m)
    turned = np.zeros_like(apart)
    for level in tree.levels:
        parents = tree.parents[level]
        root = parents[0] < 0
        above, turn = (0.0, 0.0) if root else (apart[:, parents], turned[:, parents])
        wanted, reach = apart[:, level], reach_s[level]
        known = np.isfinite(wanted).all(axis=-1, keepdims=True)
        turned[:, level] = np.where(known, turn + (wanted - above) / reach, 0.0)
        apart[:, level] = np.where(known, wanted, above - reach * turn)
    state = belief.state.copy()
    state[rows, :, 3:] += turned
    shares[rows] = np.where(np.isfinite(joints_m).all(axis=-1), drift_share, 1.0)
    return replace(belief, state=state, drift_share=shares)
