"""Steer the filter: velocities towards what a predictor foresees, and less process noise.

The process noise says what the filter's own motion, a velocity that fades, leaves open. A predictor
that knows how people move foresees a part of that, and says which by the errors that it expects.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from e3pose.estimate.filter.motion import fading
from e3pose.estimate.filter.state import Belief, Floats, Ints, Model
from e3pose.estimate.filter.tree import Tree

# Of the way from the filter's own prediction to the other one. The errors of the two hang together,
# and far from what was learned the filter's is the safer one; 0.5 to 0.7 are alike
# (`docs/experiments/2026-11-22-steering-by-default.md`, which has the shares too).
GAIN = 0.5
LEAST_SHARE, MOST_SHARE = 0.4, 2.0  # of the process noise; 1 is that of the unsteered filter
SQUARES = 3 * np.pi / 8  # mean square of a distance over the square of its mean, on three axes


def steer(
    tree: Tree,
    belief: Belief,
    rows: Ints,
    joints_m: Floats,
    ahead_s: float,
    drift_share: Floats | float = 1.0,
) -> Belief:
    """Return the belief whose prediction is half way to another one, and surer.

    Positions and covariances stay: they say what views told. The velocity carries the difference
    on into later slots, and views correct it as they correct any velocity.

    Args:
        tree: of the skeleton; joints move beside their parents.
        belief: of now.
        rows: `(num_steered,)` of its tracks.
        joints_m: `(num_steered, num_joints, 3)` where else they are expected; NaN leaves a joint.
        ahead_s: in how many seconds.
        drift_share: `(num_steered, num_joints)` of the process noise that is left until the next
            call (`unforeseen`); all of it for joints that are left.
    """
    shares = np.ones_like(belief.drift_share)
    if ahead_s <= 0 or not np.isfinite(joints_m).any():
        return replace(belief, drift_share=shares)
    from e3pose.estimate.filter.kernels.motion import steer_all

    state = belief.state.copy()
    left = np.empty(joints_m.shape[:2])
    left[:] = drift_share
    steer_all(
        float(ahead_s),
        GAIN,
        tree.order,
        tree.parents,
        tree.lasts_s,
        tree.swing_per_s2,
        rows,
        np.ascontiguousarray(joints_m),
        left,
        state,
        shares,
    )
    return replace(belief, state=state, drift_share=shares)


def unforeseen(model: Model, error_m: Floats, interval_s: float) -> Floats:
    """Return `(num_steered, num_joints)`: the share of the process noise that is left.

    A predictor that says how fast its error grows says what it does not foresee: its share of what
    the filter's own motion leaves open between the first slot to come and the second.

    Args:
        model: of the filter.
        error_m: `(num_slots, num_steered, num_joints)` expected distances, two slots or more; NaN
            where unknown, as then the share is.
        interval_s: seconds a slot.
    """
    grown = SQUARES * (error_m[1] ** 2 - error_m[0] ** 2)
    share = LEAST_SHARE + grown / (3 * _left_open(model, interval_s))
    return np.asarray(np.minimum(np.maximum(share, LEAST_SHARE), MOST_SHARE))


@lru_cache(maxsize=8)
def _left_open(model: Model, interval_s: float) -> Floats:
    """Return `(num_joints,)` m2 along an axis that the motion leaves open in the second slot."""
    drift, lasts_s = model.alone
    first, second = (fading(drift, lasts_s, slots * interval_s)[1][..., 0, 0] for slots in (1, 2))
    return np.asarray(second - first)
