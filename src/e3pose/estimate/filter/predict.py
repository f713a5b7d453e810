"""The prediction step: the loops of `filter.motion`."""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.motion import ACCELERATION_LASTS_S, move
from e3pose.estimate.filter.scratch import Constants, Passes, Tracks
from e3pose.estimate.filter.tree import backward, decompose, forward


@kernel
def predict(
    num_tracks: int, dt: float, constants: Constants, tracks: Tracks, passes: Passes
) -> None:
    """Move the first `num_tracks` tracks on by `dt` seconds, in place."""
    bias_fade = math.exp(-dt / constants.memory.lasting_s)
    num_joints = len(constants.order)
    for track in range(num_tracks):
        _advance(
            dt,
            constants,
            tracks.state[track],
            tracks.covariance[track].reshape(num_joints, 36),
            tracks.shared[track].reshape(num_joints, 36),
            tracks.drift_share[track],
            passes,
        )
        for joint in range(num_joints):
            tracks.unmeasured_s[track, joint] += dt
            for camera in range(tracks.bias_px.shape[1]):
                tracks.bias_px[track, camera, joint, 0] *= bias_fade
                tracks.bias_px[track, camera, joint, 1] *= bias_fade


@kernel
def _advance(
    dt: float,
    constants: Constants,
    state: Floats,
    covariance: Floats,
    shared: Floats,
    drift_share: Floats,
    passes: Passes,
) -> None:
    """Move one track on, in place; blocks are rows of 36.

    `before` is the covariance of a joint now with the same joint then.
    """
    moved, spread, with_parent = passes.moved, passes.own, passes.across
    before, factors = passes.prior_own, passes.prior_across
    move(dt, constants.order, constants.parents, constants.lasts_s, state, moved)
    for place in range(len(constants.order)):
        joint = constants.order[place]
        parent = constants.parents[joint]
        tau = constants.lasts_s[joint]
        fade = math.exp(-dt / tau)
        reach = tau * (1.0 - fade)
        if parent < 0:
            lean = passes.room[1]
            for entry in range(36):
                lean[entry] = covariance[joint, entry]
                with_parent[joint, entry] = 0.0
            _from_right(lean, reach, fade)
            for entry in range(36):
                before[joint, entry] = lean[entry]
                spread[joint, entry] = lean[entry]
            _from_left(spread[joint], reach, fade)
        else:
            _advance_child(joint, parent, reach, fade, covariance, shared, passes)
        gone = 1.0 - fade
        density = ACCELERATION_LASTS_S * constants.drift_m2ps4[joint] * drift_share[joint]
        pp = density * tau**2 * (dt - 2 * tau * gone + tau / 2 * (1 - fade * fade))
        pv = density * tau**2 * gone * gone / 2
        vv = density * tau / 2 * (1 - fade * fade)
        for a in range(3):
            spread[joint, 7 * a] += pp
            spread[joint, 7 * a + 3] += pv
            spread[joint, 7 * a + 18] += pv
            spread[joint, 7 * a + 21] += vv
        for entry in range(36):
            factors[joint, entry] = covariance[joint, entry]
        decompose(factors[joint])
    for joint in range(len(constants.order)):
        for entry in range(36):
            covariance[joint, entry] = spread[joint, entry]
            shared[joint, entry] = with_parent[joint, entry]
        for a in range(6):
            state[joint, a] = moved[joint, a]


@kernel
def _advance_child(
    joint: int,
    parent: int,
    reach: float,
    fade: float,
    covariance: Floats,
    shared: Floats,
    passes: Passes,
) -> None:
    """Advance the blocks of a child joint, after its parent's.

    What it has beyond its parent, x_j - x_p, fades; the parent goes its own way.
    """
    spread, with_parent = passes.own, passes.across
    before, factors = passes.prior_own, passes.prior_across
    gains, lean = passes.room[0], passes.room[1]
    for a in range(6):
        for b in range(6):
            gains[6 * a + b] = shared[joint, 6 * b + a]
    forward(factors[parent], gains)
    backward(factors[parent], gains)  # G'
    for a in range(6):
        for b in range(6):
            total = 0.0
            for k in range(6):
                total += gains[6 * k + a] * before[parent, 6 * k + b]
            # Of x_j with x_p then; of x_j - x_p, it is less by that of x_p.
            lean[6 * a + b] = total - before[parent, 6 * a + b]
            before[joint, 6 * a + b] = total
            spread[joint, 6 * a + b] = (
                covariance[joint, 6 * a + b]
                - shared[joint, 6 * a + b]
                - shared[joint, 6 * b + a]
                + covariance[parent, 6 * a + b]
            )
            with_parent[joint, 6 * a + b] = covariance[joint, 6 * a + b] - shared[joint, 6 * a + b]
    _from_right(with_parent[joint], reach, fade)
    for entry in range(36):
        before[joint, entry] += with_parent[joint, entry]
    _from_left(lean, reach, fade)
    _from_left(spread[joint], reach, fade)
    _from_right(spread[joint], reach, fade)
    for a in range(6):
        for b in range(6):
            spread[joint, 6 * a + b] += (
                lean[6 * a + b] + lean[6 * b + a] + spread[parent, 6 * a + b]
            )
            with_parent[joint, 6 * a + b] = lean[6 * a + b] + spread[parent, 6 * a + b]


@kernel
def _from_left(block: Floats, reach: float, fade: float) -> None:
    """Replace M by R M."""
    for a in range(18):
        block[a] += reach * block[a + 18]
        block[a + 18] *= fade


@kernel
def _from_right(block: Floats, reach: float, fade: float) -> None:
    """Replace M by M R'."""
    for a in range(6):
        for b in range(3):
            block[6 * a + b] += reach * block[6 * a + b + 3]
            block[6 * a + b + 3] *= fade
