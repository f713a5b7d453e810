"""Outlook: people predicted for a future slot, with covariances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.base import Outlook
from e3pose.estimate.filter.state import Belief, Ints, Model
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import failed_pairs, scratch
    from e3pose.estimate.filter.kernels import outlook as kernels
else:
    failed_pairs = Deferred("e3pose.estimate.filter.kernels.failed_pairs")
    kernels = Deferred("e3pose.estimate.filter.kernels.outlook")
    scratch = Deferred("e3pose.estimate.filter.kernels.scratch")

Floats = NDArray[np.float64]


def outlook(
    model: Model,
    belief: Belief,
    ahead_s: float,
    track_ids: Ints | None = None,
    factor: float = 1.0,
) -> Outlook:
    """Return the prediction `ahead_s` seconds after the belief's slot, without new views.

    Args:
        model: of the filter.
        belief: about everybody.
        ahead_s: 0 or more.
        track_ids: `(num_tracks,)` identities; the belief's own ids by default.
        factor: on standard deviations (`stated_factor`).
    """
    drift, lasts_s = model.alone
    num_cameras, leftovers = len(model.rig), belief.leftovers
    people, pairs = belief.drift_share.shape, belief.last_seen_s.shape
    joints_m, covariance = np.empty((*people, 3)), np.empty((*people, 6, 6))
    drift_m2ps3, shows = np.empty(people), np.empty(pairs)
    needed, sigma_px = np.empty(pairs, dtype=bool), np.empty(num_cameras)
    kernels.expect(
        scratch.held_site(model),
        ahead_s,
        factor,
        drift,
        belief.state,
        belief.covariance,
        belief.drift_share,
        belief.last_seen_s,
        belief.seen_by,
        belief.confirmed,
        belief.detection_map,
        belief.noise,
        joints_m,
        covariance,
        drift_m2ps3,
        shows,
        needed,
        sigma_px,
    )
    unexplained, times_s = np.empty(num_cameras, dtype=np.int64), np.empty(num_cameras)
    failed_pairs.count_newest(
        leftovers.cameras,
        leftovers.times_s,
        leftovers.keypoints_px,
        leftovers.scores,
        np.ascontiguousarray(model.rig.image_sizes),
        belief.failed_pairs,
        unexplained,
        times_s,
    )
    return Outlook(
        track_ids=belief.track_ids if track_ids is None else track_ids,
        confirmed=belief.confirmed,
        joints_m=joints_m,
        covariance=covariance,
        drift_m2ps3=drift_m2ps3,
        velocity_lasts_s=lasts_s,
        has_memory=True,
        delivered=belief.delivered,
        shows=shows,
        last_seen_s=belief.last_seen_s,
        needed=needed,
        sigma_px=sigma_px,
        memory=model.noise.memory,
        unexplained=unexplained,
        unexplained_s=belief.time_s - times_s,
        wait_s=model.wait_s,
    )


def stated_factor(belief: Belief) -> float:
    """Return one factor that makes the standard deviations of all published people consistent.

    One factor for everybody changes what is expected, but not which cameras tell most.
    """
    return kernels.mean_factor(belief.drift_share, belief.innovations, belief.confirmed)
