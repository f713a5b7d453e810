"""Where everybody will be if nothing is seen until then, how sure that is, and who told it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.filter import blindness
from e3pose.filter.state import Belief, Model
from e3pose.filter.update import predict_positions

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What an estimator expects of a slot to come before any view of it.

    Attributes:
        track_ids: `(num_tracks,)` everybody followed, also those not yet shown.
        confirmed: `(num_tracks,)` who is shown.
        joints_m: `(num_tracks, num_joints, 3)` metres, never missing.
        covariance_m2: `(num_tracks, num_joints, 3, 3)` of `joints_m`.
        delivered: `(num_tracks, num_cameras)` in [0, 1]: what a camera's views recently told about
            the person, as a share of a view with every joint in plain sight.
        shows: `(num_tracks, num_cameras)` in [0, 1]: how likely a look of the camera shows somebody
            where the person will be, as a share of that in plain sight.
        last_seen_s: `(num_tracks, num_cameras)` seconds since each camera showed the person, by
            then; inf if never.
        sigma_px: `(num_cameras,)` error of a keypoint in plain sight.
        unexplained: `(num_cameras,)` recent detections of each camera that belong to nobody known.
    """

    track_ids: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    joints_m: Floats
    covariance_m2: Floats
    delivered: Floats
    shows: Floats
    last_seen_s: Floats
    sigma_px: Floats
    unexplained: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.track_ids)


def outlook(model: Model, belief: Belief, ahead_s: float) -> Outlook:
    """Return what is expected `ahead_s` seconds after the belief's slot, if nothing is seen."""
    joints_m, covariance_m2 = predict_positions(belief, ahead_s, model)
    places_m = joints_m[:, model.tree.levels[0][0], :2]
    chance = blindness.chance(belief.sights, np.arange(len(model.rig)), places_m, model.corner_m)
    return Outlook(
        track_ids=belief.track_ids,
        confirmed=belief.confirmed,
        joints_m=joints_m,
        covariance_m2=covariance_m2,
        delivered=belief.delivered,
        shows=np.minimum(chance.T / blindness.PLAIN, 1.0),
        last_seen_s=belief.last_seen_s + ahead_s,
        sigma_px=model.noise.sigma_px.min() * model.scales,
        unexplained=np.bincount(belief.leftovers.cameras, minlength=len(model.rig)),
    )
