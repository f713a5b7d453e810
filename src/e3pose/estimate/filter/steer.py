"""Correct velocities by a predictor, with less process noise.

The process noise says what the filter's own motion, a velocity that fades, leaves open. A predictor
that knows how people move foresees a part of that, and says which by the errors that it expects.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.base import STEER_SLOTS
from e3pose.estimate.filter.motion import fading, foresee_joints, steer_all
from e3pose.estimate.filter.state import Belief, Model
from e3pose.estimate.filter.tree import Tree
from e3pose.predict.base import Prediction

# Of the way from the filter's own prediction to the other one. The errors of the two hang together,
# and far from what was learned the filter's is the safer one; 0.5 to 0.7 are alike
# (`lab/experiments/2026-11-22-steering-by-default.md`, which has the shares too).
# tuned: share | simulated, seeds 701 and 702, CMU and Panoptic motion: 0.5 to 0.7 are alike,
#   lab/experiments/2026-11-22-steering-by-default.md | steering
GAIN = 0.5


def steer(
    tree: Tree,
    belief: Belief,
    rows: Integers,
    joints_m: Floats,
    ahead_s: float,
    drift_share: Floats | float = 1.0,
) -> Belief:
    """Return the belief steered half way to a prediction, with less process noise.

    Positions and covariances stay: they come from views. The velocity carries the difference
    on into later slots, and views correct it as they correct any velocity.

    Args:
        tree: of the skeleton; joints move beside their parents.
        belief: of now.
        rows: `(num_steered,)` of its tracks.
        joints_m: `(num_steered, num_joints, 3)` where else they are expected; NaN leaves a joint.
        ahead_s: in how many seconds.
        drift_share: `(num_steered, num_joints)` of the process noise that is left until the next
            call (`foreseen`), apart from their agility; all of it for joints that are left.
    """
    shares = np.ones_like(belief.drift_share)
    if ahead_s <= 0:
        return replace(belief, drift_share=shares)
    state = belief.state.copy()
    left = np.empty(joints_m.shape[:2])
    left[:] = drift_share
    steer_all(
        float(ahead_s),
        GAIN,
        tree.order,
        tree.parents,
        tree.lasts_s,
        rows,
        np.ascontiguousarray(joints_m),
        left,
        belief.agility,
        state,
        shares,
    )
    return replace(belief, state=state, drift_share=shares)


def foreseen(
    model: Model, history_m: Floats, prediction: Prediction, interval_s: float
) -> tuple[Floats, Floats]:
    """Return the predicted positions and remaining variances that `steer` needs.

    A predictor that says how fast its error grows says what it does not foresee: its share of what
    the filter's own motion leaves open between the first slot to come and the second.

    Args:
        model: of the filter.
        history_m: `(num_slots, num_steered, num_joints, 3)` metres, NaN where unknown.
        prediction: from that, two slots or more.
        interval_s: seconds per slot.

    Returns:
        `(num_steered, num_joints, 3)` metres after `STEER_SLOTS`, NaN where no error is stated and
        of people with a short history; `(num_steered, num_joints)` the share of the process noise
        that is left, in `[LEAST_SHARE, MOST_SHARE]` of `filter.motion`.
    """
    shape = prediction.joints_m.shape[1:]
    joints_m, shares = np.empty(shape), np.empty(shape[:2])
    foresee_joints(
        history_m,
        prediction.joints_m[STEER_SLOTS - 1],
        prediction.error_m,
        _left_open(model, interval_s),
        joints_m,
        shares,
    )
    return joints_m, shares


@lru_cache(maxsize=64)
def _left_open(model: Model, interval_s: float) -> Floats:
    """Return `(num_joints,)` m2 along an axis that the motion leaves open in the second slot."""
    drift, lasts_s = model.alone
    first, second = (fading(drift, lasts_s, slots * interval_s)[1][..., 0, 0] for slots in (1, 2))
    return np.asarray(second - first)
