"""The filter's posterior after a slot, for smoothers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.base import Posterior, Start
from e3pose.estimate.filter.state import Belief


class Grades(NamedTuple):
    """The published uncertainty of people; see `Posterior` for the rest.

    Attributes:
        stated_m2: `(num_persons, num_joints, 3, 3)` see `People.covariance_m2`.
        inflation: `(num_persons, num_joints)`.
        repeated_m2: `(num_persons, num_joints, 3, 3)`.
        lasting_m2: `(num_persons, num_joints, 3, 3)`.
        bias_share: `(2,)` sum, and how many are summed.
    """

    stated_m2: Floats
    inflation: Floats
    repeated_m2: Floats
    lasting_m2: Floats
    bias_share: Floats

    @classmethod
    def empty(cls, num_persons: int, num_joints: int) -> Grades:
        """Return room for grades."""
        shape = num_persons, num_joints
        wide = (*shape, 3, 3)
        return cls(np.empty(wide), np.empty(shape), np.empty(wide), np.empty(wide), np.zeros(2))

    def share_of_biases(self) -> float:
        """Return the mean square of biases over the variance of a keypoint; NaN without people."""
        total, count = self.bias_share.tolist()
        return total / count if count else np.nan


def posterior_of(
    before: Belief,
    belief: Belief,
    rows: Integers,
    grades: Grades,
    excess: float,
) -> Posterior:
    """Return the posterior of a belief, which is not copied.

    Args:
        before: what the slot began with.
        belief: after the slot.
        rows: `(num_persons,)` the tracks that are published.
        grades: of these.
        excess: of `Posterior`.
    """
    return Posterior(
        belief.time_s,
        belief.track_ids,
        rows,
        belief.state,
        belief.covariance,
        belief.shared,
        belief.bones_m,
        belief.bone_counts,
        Start(before.time_s, before.track_ids, before.state, before.drift_share),
        grades.inflation,
        grades.repeated_m2,
        grades.lasting_m2,
        excess,
    )
