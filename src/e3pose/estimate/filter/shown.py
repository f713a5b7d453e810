"""Who is shown: people who are followed, are still there, and are where they are thought to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.estimate.filter import doors
from e3pose.estimate.filter.state import Belief, Flags, Floats, Ints, Model

SHOWN_SPREAD_M = 0.2  # whose every joint is less certain is followed, but not shown
MOST_LEFT_ODDS = 1.0  # who has more likely left than not is followed, but not shown
ALONE_S, WALK_MPS = 1.2, 0.3  # and so is who walks, led for so long by one camera alone


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The people of one slot.

    Attributes:
        track_ids: `(num_persons,)` identities, rising.
        joints_m: `(num_persons, num_joints, 3)` metres; NaN for joints never measured.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of `joints_m`; NaN likewise.
        measured: `(num_persons, num_joints)` whether a view of this slot measured the joint; the
            others are carried on from earlier slots.
    """

    track_ids: Ints
    joints_m: Floats
    covariance_m2: Floats
    measured: Flags

    def __len__(self) -> int:
        return len(self.track_ids)


def shown(belief: Belief, model: Model) -> Flags:
    """Return `(num_tracks,)`: who is shown; the others are followed, to be found again."""
    trace = np.trace(belief.covariance[..., :3, :3], axis1=-2, axis2=-1)
    certain = np.sqrt(trace.min(axis=-1)) < SHOWN_SPREAD_M
    there = doors.left_odds(belief, model) < MOST_LEFT_ODDS
    return np.asarray(belief.confirmed & certain & there & ~_led_alone(belief))


def needed(belief: Belief, ahead_s: float) -> Flags:
    """Return `(num_tracks, num_cameras)`: cameras of which one must show a person, who is hidden
    otherwise.

    Somebody new is shown once a third camera has seen the person, and who walks while a second one
    does. Nobody else needs a camera.

    Args:
        belief: about everybody.
        ahead_s: seconds after the belief's slot, if nothing is seen until then.
    """
    leading = belief.last_seen_s <= belief.last_seen_s.min(axis=1, keepdims=True, initial=np.inf)
    led = _led_alone(belief, ahead_s)[:, None] & ~leading
    return np.where(belief.confirmed[:, None], led, ~belief.seen_by)


def _led_alone(belief: Belief, ahead_s: float = 0.0) -> Flags:
    """Return `(num_tracks,)`: who walks and has long been seen by one camera alone, or by none.

    The depth along the rays of one camera follows from the lengths of bones and from the velocity
    of before, and is surer than it should be: who turns meanwhile is soon half a metre off.
    """
    second_s = np.sort(belief.last_seen_s, axis=1)[:, 1:2].min(axis=1, initial=np.inf) + ahead_s
    speed_mps = np.linalg.norm(belief.state[..., 3:].mean(axis=1), axis=-1)
    return np.asarray((second_s > ALONE_S) & (speed_mps > WALK_MPS))


def estimate_of(belief: Belief, model: Model) -> Estimate:
    """Return the people who are believed to be there, and where."""
    rows = np.flatnonzero(shown(belief, model))
    known = np.isfinite(belief.unmeasured_s[rows])
    return Estimate(
        belief.track_ids[rows],
        np.where(known[..., None], belief.state[rows, :, :3], np.nan),
        np.where(known[..., None, None], belief.covariance[rows, :, :3, :3], np.nan),
        belief.unmeasured_s[rows] == 0,
    )
