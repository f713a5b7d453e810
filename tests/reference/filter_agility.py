"""How much more than expected people move, learned from corrections: `filter.agility`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.reference.filter_update import Sightings, pixel_variance

from e3pose.base.arrays import Flags, Integers
from e3pose.estimate.filter.compare import FURTHEST, LASTS_S, RATE
from e3pose.estimate.filter.outliers import OUTLIER_SIGMAS
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.state import Belief
from e3pose.model.projection import MIN_DEPTH_M, project


def learn(belief: Belief, seen: Sightings, cameras: Integers, dt: float) -> Belief:
    """Return the belief after keypoints were compared with the correction before them."""
    agility = belief.agility * np.exp(-dt / LASTS_S)
    if len(belief) and len(cameras):
        newest_s = belief.last_seen_s.min(axis=1)
        fresh = newest_s + dt <= LASTS_S
        pixels, depth, jacobian = project(belief.state[..., :3], seen.projections)
        error = seen.keypoints_px - pixels
        moved = (jacobian @ belief.corrected_m[..., None])[..., 0]
        total = (seen.sigma_px * seen.look) ** 2
        total = total + pixel_variance(jacobian, belief.covariance[..., :3, :3])
        total = total + (error**2).sum(axis=-1) / OUTLIER_SIGMAS**2
        for view, camera in enumerate(cameras.tolist()):
            other = np.asarray(fresh & (belief.last_seen_s[:, camera] > newest_s))
            usable = (seen.scores[view] > USED_SCORE) & (depth[view] > MIN_DEPTH_M)
            usable &= np.broadcast_to(other, (1, len(belief))).T
            alike = (error[view] * moved[view]).sum(axis=-1) / total[view]
            step = np.where(usable, RATE * np.clip(alike, -1, 1), 0.0)
            agility = np.clip(agility + step, -FURTHEST, FURTHEST)
    return replace(belief, agility=agility)


def note(belief: Belief, predicted: Belief, matched: Flags) -> Belief:
    """Return the belief with how far the looks moved the joints of those whom they showed.

    `matched` is `(num_views, num_tracks)`.
    """
    shown = np.asarray(matched.any(axis=0))
    moved_m = belief.state[..., :3] - predicted.state[..., :3]
    corrected_m = np.where(shown[:, None, None], moved_m, belief.corrected_m)
    return replace(belief, corrected_m=corrected_m)
