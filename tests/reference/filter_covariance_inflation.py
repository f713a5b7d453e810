"""How wrong predictions are, learned from innovations: `filter.covariance_inflation`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.reference.filter_learned_noise import own_share, proved
from tests.reference.filter_update import Sightings, pixel_variance

from e3pose.base.arrays import Integers
from e3pose.estimate.filter import bias
from e3pose.estimate.filter.covariance_inflation import (
    ALONE,
    CLIP,
    LEAST_SHARE,
    MEMORY_S,
    MOST_M,
    OWN_SHARE,
    STEERED,
)
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.projection import MIN_DEPTH_M, project


def learn(belief: Belief, seen: Sightings, cameras: Integers, dt: float, model: Model) -> Belief:
    """Return the belief after the views of a slot were compared with the predicted people."""
    sums_m = belief.innovations * np.exp(-dt / MEMORY_S)
    if len(belief) == 0 or len(cameras) == 0:
        return replace(belief, innovations=sums_m)
    since_s = belief.last_seen_s + dt
    taught = proved(belief, seen, cameras, since_s)
    pixels, depth, jacobian = project(belief.state[..., :3], seen.projections)
    usable = (seen.scores > USED_SCORE) & (depth > MIN_DEPTH_M) & taught[:, None]
    factor = np.where(belief.drift_share == 1.0, ALONE, STEERED)
    doubt = factor**2 * pixel_variance(jacobian, belief.covariance[..., :3, :3])
    terms = bias.memory_terms(model.noise.memory)
    left_over = own_share(since_s[:, cameras].T, terms)[..., None]
    total = doubt + OWN_SHARE * left_over * seen.sigma_px**2
    usable &= doubt > LEAST_SHARE * total
    off = np.linalg.norm(seen.keypoints_px - pixels, axis=-1)
    expected_px = np.sqrt(np.pi / 2 * total)
    px_per_m = np.sqrt((jacobian**2).sum(axis=(-1, -2)) / 2)
    expected_m = np.where(usable, np.minimum(expected_px / px_per_m, MOST_M), 0.0)
    ratios = np.where(usable, np.minimum(off / expected_px, CLIP), 0.0)
    fresh_m = np.stack([ratios * expected_m, expected_m], axis=-1).sum(axis=(0, 2))
    return replace(belief, innovations=sums_m + fresh_m)
