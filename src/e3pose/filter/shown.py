"""Who is shown: people who are followed, are still there, and are where they are thought to be."""

from __future__ import annotations

import numpy as np

from e3pose.filter import doors
from e3pose.filter.state import Belief, Flags, Floats, Model

SHOWN_SPREAD_M = 0.2  # whose every joint is less certain is followed, but not shown
MOST_LEFT_ODDS = 1.0  # who has more likely left than not is followed, but not shown
WALK_MPS = 0.3  # who is slower stays where two cameras saw them
MOST_DOUBT_S = 1.7


def shown(belief: Belief, model: Model) -> Flags:
    """Return `(num_tracks,)`: who is shown; the others are followed, to be found again."""
    trace = np.trace(belief.covariance[..., :3, :3], axis1=-2, axis2=-1)
    certain = np.sqrt(trace.min(axis=-1)) < SHOWN_SPREAD_M
    there = doors.left_odds(belief, model) < MOST_LEFT_ODDS
    return np.asarray(belief.confirmed & certain & there & (doubt_s(belief) < MOST_DOUBT_S))


def doubt_s(belief: Belief) -> Floats:
    """Return `(num_tracks,)`: for how long one camera alone has led a walking person.

    The filter knows the depth of a person along the rays of one camera from the lengths of bones
    and from the velocity of before; who turns meanwhile is soon somewhere else. The time counts
    for more where other cameras look and do not find the person (`Belief.existence`).
    """
    since_s = np.sort(belief.last_seen_s, axis=1)[:, 1:2].min(axis=1, initial=np.inf)
    speed_mps = np.linalg.norm(belief.state[..., 3:].mean(axis=1), axis=-1)
    existence = np.maximum(belief.existence, 1e-3)
    return np.where(speed_mps > WALK_MPS, since_s / existence, 0.0)
