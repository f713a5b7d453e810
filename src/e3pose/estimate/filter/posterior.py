"""The filter's posterior after a slot, for smoothers."""

from __future__ import annotations

from e3pose.estimate.base import Posterior, Start
from e3pose.estimate.filter.state import Belief, Ints


def posterior_of(before: Belief, belief: Belief, track_ids: Ints) -> Posterior:
    """Return the posterior of a belief; nothing is copied.

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
        belief.bones_m,
        belief.bone_counts,
        Start(before.time_s, before.track_ids, before.state, before.drift_share),
    )
