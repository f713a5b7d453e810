"""Who is shown: people who are followed, are still there, and are where they are thought to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.estimate.filter.state import Belief, Flags, Floats, Ints, Model


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
    from e3pose.estimate.filter.kernels.shown import who_is_shown

    flags = np.empty(len(belief), dtype=bool)
    who_is_shown(
        int(model.tree.order[0]),
        model.corner_m,
        belief.state,
        belief.covariance,
        belief.confirmed,
        belief.last_seen_s,
        belief.missed,
        belief.detection_map,
        belief.exits,
        flags,
    )
    return flags


def needed(belief: Belief, ahead_s: float) -> Flags:
    """Return `(num_tracks, num_cameras)`: cameras of which one must show a person, who is hidden
    otherwise.

    Somebody new is shown once a third camera has seen the person, and who walks while a second one
    does. Nobody else needs a camera.

    Args:
        belief: about everybody.
        ahead_s: seconds after the belief's slot, if nothing is seen until then.
    """
    from e3pose.estimate.filter.kernels.shown import led_alone

    leading = belief.last_seen_s <= belief.last_seen_s.min(axis=1, keepdims=True, initial=np.inf)
    alone = [
        led_alone(*track, ahead_s) for track in zip(belief.state, belief.last_seen_s, strict=True)
    ]
    led = np.array(alone, dtype=bool)[:, None] & ~leading
    return np.where(belief.confirmed[:, None], led, ~belief.seen_by)


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
