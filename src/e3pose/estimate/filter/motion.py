"""Motion model: each joint relative to its parent, the root in the world.

    x_j' = x_p' + R_j (x_j - x_p) + w_j,    R = [1, tau (1 - exp(-dt / tau)); 0, exp(-dt / tau)]

A person who walks keeps on walking: the root's velocity lasts. What a limb does beside the body
turns round within a quarter of a second, and sooner the farther out it is; so a foot that nobody
sees soon goes with the body. The noise w is that of a velocity with a life of tau, exactly: short
steps add up to what one long step says.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.tree import Tree

ACCELERATION_LASTS_S = 1 / 25  # definition: those of `tree` are drawn anew so often
# tuned: slots | not recorded | known slots
LEAST_KNOWN_SLOTS = 4  # of a history before what is predicted from it counts
# tuned: share, share | simulated, seeds 701 and 702, CMU and Panoptic motion (most); pizza (least),
#   lab/experiments/2026-11-23-agility.md | steering
LEAST_SHARE, MOST_SHARE = 0.2, 2.0  # of the process noise; 1 is that of the unsteered filter
SQUARES = 3 * math.pi / 8  # definition: mean square of a distance over its squared mean


def places(tree: Tree, state: Floats, dt: float) -> Floats:
    """Return the state `dt` seconds later.

    Args:
        tree: of the skeleton.
        state: `(num_tracks, num_joints, 6)` metres, metres per second.
        dt: seconds, 0 or more.
    """
    moved = np.empty_like(state, order="C")
    move_all(
        float(dt),
        tree.order,
        tree.parents,
        tree.lasts_s,
        np.ascontiguousarray(state),
        moved,
    )
    return moved


def alone(tree: Tree) -> tuple[Floats, Floats]:
    """Return each joint's motion in the world as one process, independent of other joints.

    It takes part in what all joints above it do. Its velocity lasts as long as theirs do, by their
    share of the noise.

    Returns:
        `(num_joints,)` power density of the acceleration along an axis, m2/s3, and `(num_joints,)`
        seconds until a velocity is down to 1/e.
    """
    own = ACCELERATION_LASTS_S * tree.drift_m2ps4
    total, lasting = own.copy(), own * tree.lasts_s
    for level in tree.levels[1:]:
        total[level] += total[tree.parents[level]]
        lasting[level] += lasting[tree.parents[level]]
    return total, lasting / total


def fading(density_m2ps3: Floats, lasts_s: Floats, dt: float) -> tuple[Floats, Floats]:
    """Return R and the covariance of w along one axis, `(*batch, 2, 2)` each.

    Args:
        density_m2ps3: `(*batch)` power density of the acceleration.
        lasts_s: `(*batch)` until a velocity is down to 1/e.
        dt: seconds, 0 or more.
    """
    tau = lasts_s
    fade = np.exp(-dt / tau)
    gone = 1 - fade
    step = np.array([[np.ones_like(tau), tau * gone], [np.zeros_like(tau), fade]])
    pp = tau**2 * (dt - 2 * tau * gone + tau * (1 - fade**2) / 2)
    pv, vv = (tau * gone) ** 2 / 2, tau * (1 - fade**2) / 2
    noise: Floats = np.array([[pp, pv], [pv, vv]]) * density_m2ps3
    R = np.moveaxis(step, (0, 1), (-2, -1))
    W = np.moveaxis(noise, (0, 1), (-2, -1))
    return np.asarray(R, dtype=np.float64), np.asarray(W, dtype=np.float64)


def transitions(tree: Tree, dt: float) -> tuple[Floats, Floats]:
    """Return R and the covariance of w of each joint, `(num_joints, 6, 6)` each.

    Args:
        tree: of the skeleton.
        dt: seconds, 0 or more.
    """
    step, noise = fading(ACCELERATION_LASTS_S * tree.drift_m2ps4, tree.lasts_s, dt)
    R, W = (np.asarray(np.kron(each, np.eye(3)), dtype=np.float64) for each in (step, noise))
    return R, W


@kernel
def move(
    dt: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    state: Floats,
    moved: Floats,
) -> None:
    """Fill `moved` with the `state` of a body `dt` seconds later, `(num_joints, 6)` both.

    Args:
        dt: seconds, 0 or more.
        order: `(num_joints,)` the root first, each joint after its parent.
        parents: `(num_joints,)`, -1 at the root; like all that follow of `tree.Tree`.
        lasts_s: `(num_joints,)`.
        state: metres, metres per second.
        moved: filled.
    """
    for joint in order:
        parent, tau = parents[joint], lasts_s[joint]
        fade = math.exp(-dt / tau)
        reach = tau * (1.0 - fade)
        for a in range(3):
            if parent < 0:
                moved[joint, a] = state[joint, a] + reach * state[joint, a + 3]
                moved[joint, a + 3] = fade * state[joint, a + 3]
            else:
                beside = state[joint, a] - state[parent, a]
                speed = state[joint, a + 3] - state[parent, a + 3]
                moved[joint, a] = moved[parent, a] + beside + reach * speed
                moved[joint, a + 3] = moved[parent, a + 3] + fade * speed


@kernel
def move_all(
    dt: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    state: Floats,
    moved: Floats,
) -> None:
    """Fill `moved` `(num_tracks, num_joints, 6)` with `move` of all tracks."""
    for track in range(len(state)):
        move(dt, order, parents, lasts_s, state[track], moved[track])


@kernel
def steer_all(
    ahead_s: float,
    gain: float,
    order: Integers,
    parents: Integers,
    lasts_s: Floats,
    rows: Integers,
    joints_m: Floats,
    drift_share: Floats,
    agility: Floats,
    state: Floats,
    shares: Floats,
) -> None:
    """Change velocities so that joints move part of the way to their predicted positions.

    A joint that is not foreseen keeps its own place beside the others.

    Args:
        ahead_s: in how many seconds they are foreseen.
        gain: the part of the way.
        order: as of `move`, like all up to `lasts_s`.
        parents: `(num_joints,)`.
        lasts_s: `(num_joints,)`.
        rows: `(num_steered,)` of the tracks.
        joints_m: `(num_steered, num_joints, 3)` where joints are foreseen; NaN where they are not.
        drift_share: `(num_steered, num_joints)` of the process noise that is left for them.
        agility: `(num_tracks, num_joints)` of `Belief`, a factor on that.
        state: `(num_tracks, num_joints, 6)` whose velocities are turned, in place.
        shares: `(num_tracks, num_joints)` filled where joints are foreseen.
    """
    num_joints = len(order)
    moved = np.empty((num_joints, 6))
    apart, turned = np.empty((num_joints, 3)), np.empty((num_joints, 3))
    for index in range(len(rows)):
        track = rows[index]
        move(ahead_s, order, parents, lasts_s, state[track], moved)
        for joint in order:
            parent, tau = parents[joint], lasts_s[joint]
            reach = tau * (1.0 - math.exp(-ahead_s / tau))
            finite = True
            for a in range(3):
                finite = finite and math.isfinite(joints_m[index, joint, a])
            for a in range(3):
                above = apart[parent, a] if parent >= 0 else 0.0
                turn = turned[parent, a] if parent >= 0 else 0.0
                if finite:
                    apart[joint, a] = gain * (joints_m[index, joint, a] - moved[joint, a])
                    turned[joint, a] = turn + (apart[joint, a] - above) / reach
                else:
                    apart[joint, a] = above - reach * turn
                    turned[joint, a] = 0.0
            if finite:
                left = drift_share[index, joint] * math.exp(agility[track, joint])
                shares[track, joint] = left
        for joint in order:
            for a in range(3):
                state[track, joint, a + 3] += turned[joint, a]


@kernel
def foresee_joints(
    history_m: Floats,
    predicted_m: Floats,
    error_m: Floats,
    left_open_m2: Floats,
    joints_m: Floats,
    shares: Floats,
) -> None:
    """Fill the result of `filter.estimator.foreseen`.

    Args:
        history_m: `(num_slots, num_steered, num_joints, 3)` metres.
        predicted_m: `(num_steered, num_joints, 3)` metres.
        error_m: `(num_leads, num_steered, num_joints)` expected distances, NaN where unknown.
        left_open_m2: `(num_joints,)` what the filter's motion adds in the second slot to come.
        joints_m: `(num_steered, num_joints, 3)` filled.
        shares: `(num_steered, num_joints)` filled.
    """
    for track in range(len(joints_m)):
        slots = 0
        for slot in range(len(history_m)):
            slots += _shows_anything(history_m[slot, track])
        for joint in range(joints_m.shape[1]):
            first_m, second_m = error_m[0, track, joint], error_m[1, track, joint]
            stated = math.isfinite(second_m) and slots >= LEAST_KNOWN_SLOTS
            grown = SQUARES * (second_m**2 - first_m**2)
            share = LEAST_SHARE + grown / (3 * left_open_m2[joint])
            shares[track, joint] = min(max(share, LEAST_SHARE), MOST_SHARE)
            for axis in range(3):
                joints_m[track, joint, axis] = predicted_m[track, joint, axis] if stated else np.nan


@kernel
def _shows_anything(joints_m: Floats) -> bool:
    """Return whether any joint `(num_joints, 3)` is finite."""
    for joint in range(len(joints_m)):
        finite = True
        for axis in range(3):
            finite = finite and math.isfinite(joints_m[joint, axis])
        if finite:
            return True
    return False
