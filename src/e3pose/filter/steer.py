"""Turn velocities towards where somebody who knows how people move expects the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.filter.state import Belief, Floats, Ints
from e3pose.filter.update import VELOCITY_LASTS_S

# Of the way from the filter's own prediction to the other one. The errors of the two hang together,
# and far from what was learned the filter's is the safer one; 0.5 to 0.7 are alike
# (`docs/experiments/2026-11-22-predictor-in-the-loop.md`).
GAIN = 0.5


def steer(belief: Belief, rows: Ints, joints_m: Floats, ahead_s: float) -> Belief:
    """Return the belief whose prediction is half way to another one.

    Positions and covariances stay: they say what views told. The velocity carries the difference
    on into later slots, and views correct it as they correct any velocity.

    Args:
        belief: of now.
        rows: `(num_steered,)` of its tracks.
        joints_m: `(num_steered, num_joints, 3)` where else they are expected; NaN leaves a joint.
        ahead_s: in how many seconds.
    """
    if ahead_s <= 0 or not np.isfinite(joints_m).any():
        return belief
    moves_s = VELOCITY_LASTS_S * (1 - np.exp(-ahead_s / VELOCITY_LASTS_S))
    state = belief.state.copy()
    position, velocity = state[rows, :, :3], state[rows, :, 3:]
    turned = velocity + GAIN * ((joints_m - position) / moves_s - velocity)
    known = np.isfinite(joints_m).all(axis=-1, keepdims=True)
    state[rows, :, 3:] = np.where(known, turned, velocity)
    return replace(belief, state=state)
