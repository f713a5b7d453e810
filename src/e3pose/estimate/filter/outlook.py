"""Where everybody will be if nothing is seen until then, how sure that is, and who showed it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter import blindness, learned_noise
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.shown import needed
from e3pose.estimate.filter.state import Belief, Leftovers, Model

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What an estimator expects of a slot to come, and what it knows in its newest slot.

    Attributes:
        track_ids: `(num_tracks,)` everybody followed, also those not yet shown.
        confirmed: `(num_tracks,)` who is shown.
        joints_m: `(num_tracks, num_joints, 3)` metres in the slot to come, never missing.
        covariance: `(num_tracks, num_joints, 6, 6)` of position and velocity in the newest slot,
            metres and metres per second.
        drift_m2ps3: `(num_tracks, num_joints)` power density of the acceleration along an axis.
        velocity_lasts_s: `(num_joints,)` until a velocity is down to 1/e.
        remembers: whether views of slots in between tell about the slot to come.
        delivered: `(num_tracks, num_cameras)` in [0, 1]: what a camera's views recently told about
            the person, as a share of a view with every joint in plain sight.
        shows: `(num_tracks, num_cameras)` in [0, 1]: how likely a look of the camera shows somebody
            where the person will be, as a share of that in plain sight.
        last_seen_s: `(num_tracks, num_cameras)` seconds since each camera showed the person; inf if
            never.
        needed: `(num_tracks, num_cameras)` cameras of which one must show the person by then, or
            the person is not shown; none for people who are shown anyway.
        sigma_px: `(num_cameras,)` error of a keypoint in plain sight.
        unexplained: `(num_cameras,)` detections of each camera's newest look that no track
            explains, as long as they wait for another camera.
        unexplained_s: `(num_cameras,)` seconds since that look.
        wait_s: how far apart two looks may be to start a person.
    """

    track_ids: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    joints_m: Floats
    covariance: Floats
    drift_m2ps3: Floats
    velocity_lasts_s: Floats
    remembers: bool
    delivered: Floats
    shows: Floats
    last_seen_s: Floats
    needed: NDArray[np.bool_]
    sigma_px: Floats
    unexplained: NDArray[np.int64]
    unexplained_s: Floats
    wait_s: float

    def __len__(self) -> int:
        return len(self.track_ids)


def outlook(model: Model, belief: Belief, ahead_s: float) -> Outlook:
    """Return what is expected `ahead_s` seconds after the belief's slot, if nothing is seen."""
    joints_m = places(model.tree, belief.state, ahead_s)[..., :3]
    drift, lasts_s = model.alone
    places_m = joints_m[:, model.tree.levels[0][0], :2]
    chance = blindness.chance(belief.sights, np.arange(len(model.rig)), places_m, model.corner_m)
    unexplained, times_s = _newest(belief.leftovers, len(model.rig))
    return Outlook(
        track_ids=belief.track_ids,
        confirmed=belief.confirmed,
        joints_m=joints_m,
        covariance=belief.covariance,
        drift_m2ps3=drift * belief.drift_share,
        velocity_lasts_s=lasts_s,
        remembers=True,
        delivered=belief.delivered,
        shows=np.minimum(chance.T / blindness.PLAIN, 1.0),
        last_seen_s=belief.last_seen_s,
        needed=needed(belief, ahead_s),
        sigma_px=learned_noise.knots_px(model, belief.noise).min(axis=-1),
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
