"""Outlook: predicted people at a future slot with their covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.base import Outlook
from e3pose.estimate.filter import learned_noise
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.shown import needed
from e3pose.estimate.filter.state import Belief, Leftovers, Model

Floats = NDArray[np.float64]


def outlook(model: Model, belief: Belief, ahead_s: float) -> Outlook:
    """Return what is expected `ahead_s` seconds after the belief's slot, if nothing is seen."""
    from e3pose.estimate.filter.kernels.shown import chances

    joints_m = places(model.tree, belief.state, ahead_s)[..., :3]
    drift, lasts_s = model.alone
    shows = np.empty((len(belief), len(model.rig)))
    chances(belief.detection_map, joints_m, model.tree.order[0], model.corner_m, shows)
    unexplained, times_s = _newest(belief.leftovers, len(model.rig))
    return Outlook(
        track_ids=belief.track_ids,
        confirmed=belief.confirmed,
        joints_m=joints_m,
        covariance=belief.covariance,
        drift_m2ps3=drift * belief.drift_share,
        velocity_lasts_s=lasts_s,
        has_memory=True,
        delivered=belief.delivered,
        shows=shows,
        last_seen_s=belief.last_seen_s,
        needed=needed(belief, ahead_s),
        sigma_px=learned_noise.sigma_px(model, belief.noise),
        memory=model.noise.memory,
        unexplained=unexplained,
        unexplained_s=belief.time_s - times_s,
        wait_s=model.wait_s,
    )


def _newest(waiting: Leftovers, num_cameras: int) -> tuple[NDArray[np.int64], Floats]:
    """Return `(num_cameras,)` detections of each camera's newest look, and the time of that."""
    times_s = np.full(num_cameras, -np.inf)
    np.maximum.at(times_s, waiting.cameras, waiting.times_s)
    newest = waiting.cameras[waiting.times_s == times_s[waiting.cameras]]
    return np.bincount(newest, minlength=num_cameras), times_s
