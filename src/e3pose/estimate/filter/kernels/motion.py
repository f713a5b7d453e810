"""Where bodies move while nobody looks (`filter.motion`), and how a predictor steers them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.motion import SHORTEST_S, WALKS_MPS
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@kernel
def move(
    dt: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    swing_per_s2: Floats,
    state: Floats,
    moved: Floats,
) -> None:
    """Fill `moved` with the `state` of a body `dt` seconds later, `(num_joints, 6)` both.

    Args:
        dt: seconds, 0 or more.
        order: `(num_joints,)` the root first, each joint after its parent.
        parents: `(num_joints,)`, -1 at the root; like all that follow of `tree.Tree`.
        lasts_s: `(num_joints,)`.
        swing_per_s2: `(num_joints,)`.
        state: metres, metres a second.
        moved: filled.
    """
    root = order[0]
    walks = math.sqrt(state[root, 3] ** 2 + state[root, 4] ** 2) / WALKS_MPS
    walks = walks * walks if walks < 1.0 else 1.0
    most = 1.0 / max(dt, SHORTEST_S) ** 2
    for joint in order:
        parent, tau = parents[joint], lasts_s[joint]
        fade = math.exp(-dt / tau)
        reach = tau * (1.0 - fade)
        swing = walks * min(swing_per_s2[joint], most)
        for a in range(3):
            if parent < 0:
                moved[joint, a] = state[joint, a] + reach * state[joint, a + 3]
                moved[joint, a + 3] = fade * state[joint, a + 3]
            else:
                beside = state[joint, a] - state[parent, a]
                speed = state[joint, a + 3] - state[parent, a + 3]
                push = -swing * beside if a < 2 else 0.0
                moved[joint, a] = (
                    moved[parent, a] + beside + reach * speed + tau * (dt - reach) * push
                )
                moved[joint, a + 3] = moved[parent, a + 3] + fade * speed + reach * push


@kernel
def move_all(
    dt: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    swing_per_s2: Floats,
    state: Floats,
    moved: Floats,
) -> None:
    """Fill `moved` `(num_tracks, num_joints, 6)` with `move` of everybody."""
    for track in range(len(state)):
        move(dt, order, parents, lasts_s, swing_per_s2, state[track], moved[track])


@kernel
def steer_all(
    ahead_s: float,
    gain: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    swing_per_s2: Floats,
    rows: Integers,
    joints_m: Floats,
    drift_share: Floats,
    state: Floats,
    shares: Floats,
) -> None:
    """Turn velocities so that joints go a part of the way to where they are foreseen.

    A joint that is not foreseen keeps its own place beside the others.

    Args:
        ahead_s: in how many seconds they are foreseen.
        gain: the part of the way.
        order: as of `move`, like all up to `swing_per_s2`.
        parents: `(num_joints,)`.
        lasts_s: `(num_joints,)`.
        swing_per_s2: `(num_joints,)`.
        rows: `(num_steered,)` of the tracks.
        joints_m: `(num_steered, num_joints, 3)` where joints are foreseen; NaN where they are not.
        drift_share: `(num_steered, num_joints)` of the process noise that is left for them.
        state: `(num_tracks, num_joints, 6)` whose velocities are turned, in place.
        shares: `(num_tracks, num_joints)` filled where joints are foreseen.
    """
    num_joints = len(order)
    moved = np.empty((num_joints, 6))
    apart, turned = np.empty((num_joints, 3)), np.empty((num_joints, 3))
    for index in range(len(rows)):
        track = rows[index]
        move(ahead_s, order, parents, lasts_s, swing_per_s2, state[track], moved)
        for joint in order:
            parent, tau = parents[joint], lasts_s[joint]
            reach = tau * (1.0 - math.exp(-ahead_s / tau))
            known = True
            for a in range(3):
                known = known and math.isfinite(joints_m[index, joint, a])
            for a in range(3):
                above = apart[parent, a] if parent >= 0 else 0.0
                turn = turned[parent, a] if parent >= 0 else 0.0
                if known:
                    apart[joint, a] = gain * (joints_m[index, joint, a] - moved[joint, a])
                    turned[joint, a] = turn + (apart[joint, a] - above) / reach
                else:
                    apart[joint, a] = above - reach * turn
                    turned[joint, a] = 0.0
            if known:
                shares[track, joint] = drift_share[index, joint]
        for joint in order:
            for a in range(3):
                state[track, joint, a + 3] += turned[joint, a]
