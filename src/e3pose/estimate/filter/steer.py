"""Turn velocities towards where somebody who knows how people move expects the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.state import Belief, Floats, Ints
from e3pose.estimate.filter.tree import Tree

# Of the way from the filter's own prediction to the other one. The errors of the two hang together,
# and far from what was learned the filter's is the safer one; 0.5 to 0.7 are alike
# (`docs/experiments/2026-11-22-predictor-in-the-loop.md`).
GAIN = 0.5


def steer(tree: Tree, belief: Belief, rows: Ints, joints_m: Floats, ahead_s: float) -> Belief:
    """Return the belief whose prediction is half way to another one.

    Positions and covariances stay: they say what views told. The velocity carries the difference
    on into later slots, and views correct it as they correct any velocity.

    Args:
        tree: of the skeleton; joints move beside their parents.
        belief: of now.
        rows: `(num_steered,)` of its tracks.
        joints_m: `(num_steered, num_joints, 3)` where else they are expected; NaN leaves a joint.
        ahead_s: in how many seconds.
    """
    if ahead_s <= 0 or not np.isfinite(joints_m).any():
        return belief
    reach_s = (tree.lasts_s * (1 - np.exp(-ahead_s / tree.lasts_s)))[:, None]
    expected_m = places(tree, belief.state[rows], ahead_s)[..., :3]
    apart = GAIN * (joints_m - expected_m)
    turned = np.zeros_like(apart)
    for level in tree.levels:
        parents = tree.parents[level]
        root = parents[0] < 0
        above, turn = (0.0, 0.0) if root else (apart[:, parents], turned[:, parents])
        wanted, reach = apart[:, level], reach_s[level]
        known = np.isfinite(wanted).all(axis=-1, keepdims=True)
        turned[:, level] = np.where(known, turn + (wanted - above) / reach, 0.0)
        apart[:, level] = np.where(known, wanted, above - reach * turn)
    state = belief.state.copy()
    state[rows, :, 3:] += turned
    return replace(belief, state=state)
