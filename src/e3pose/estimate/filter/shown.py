"""Publication of tracks: confirmed, still present, and consistent with their prediction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from e3pose.estimate.filter.state import Belief, Flags, Floats, Ints, Model
from e3pose.runtime.deferred import Deferred

if TYPE_CHECKING:
    from e3pose.estimate.filter.kernels import shown as kernels
else:
    kernels = Deferred("e3pose.estimate.filter.kernels.shown")


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
    """Return `(num_tracks,)`: published tracks; the others are kept for re-association."""
    flags = np.empty(len(belief), dtype=bool)
    kernels.who_is_shown(
        int(model.tree.order[0]),
        model.corner_m,
        belief.state,
        belief.covariance,
        belief.confirmed,
        belief.last_seen_s,
        belief.missed,
        belief.detection_map,
        flags,
    )
    return flags


def estimate_of(belief: Belief, model: Model) -> Estimate:
    """Return the published people and their positions."""
    (rows,) = shown(belief, model).nonzero()
    shape = len(rows), len(model.skeleton)
    joints_m, covariance_m2 = np.empty((*shape, 3)), np.empty((*shape, 3, 3))
    measured = np.empty(shape, dtype=bool)
    kernels.show(
        model.proportions,
        rows,
        belief.unmeasured_s,
        belief.state,
        belief.covariance,
        belief.bones_m,
        belief.bone_counts,
        joints_m,
        covariance_m2,
        measured,
    )
    return Estimate(belief.track_ids[rows], joints_m, covariance_m2, measured)
