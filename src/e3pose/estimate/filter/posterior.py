"""What the filter knew of everybody after a slot: all that a smoother needs of it."""

from __future__ import annotations

from dataclasses import dataclass

from e3pose.estimate.filter.state import Belief, Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the filter's prediction of a slot started: the slot before, steered (`steer`).

    Attributes:
        time_s: of the slot before; NaN before the first.
        tracks: `(num_before,)` ids as in `Posterior`, of the slot before.
        state: `(num_before, num_joints, 6)` with the velocities as they were steered.
        drift_share: `(num_before, num_joints)` share of the process noise that was taken.
    """

    time_s: float
    tracks: Ints
    state: Floats
    drift_share: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Everybody followed, after the views of one slot.

    Attributes:
        time_s: of the slot.
        tracks: `(num_tracks,)` the belief's own ids, rising: the same for as long as it follows.
        track_ids: `(num_tracks,)` the identities that they are shown with.
        state: `(num_tracks, num_joints, 6)` position in metres, velocity in metres a second.
        covariance: `(num_tracks, num_joints, 6, 6)` of `state`.
        shared: `(num_tracks, num_joints, 6, 6)` of each joint's `state` with its parent's.
        start: what the slot was predicted from.
    """

    time_s: float
    tracks: Ints
    track_ids: Ints
    state: Floats
    covariance: Floats
    shared: Floats
    start: Start


def posterior_of(before: Belief, belief: Belief, track_ids: Ints) -> Posterior:
    """Return what a smoother needs of a belief; nothing is copied.

    Args:
        before: what the slot began with.
        belief: after the slot.
        track_ids: `(num_tracks,)` the identities of its tracks.
    """
    return Posterior(
        belief.time_s,
        belief.track_ids,
        track_ids,
        belief.state,
        belief.covariance,
        belief.shared,
        Start(before.time_s, before.track_ids, before.state, before.drift_share),
    )
