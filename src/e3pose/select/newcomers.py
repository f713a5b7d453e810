"""Newcomers: people detected by one camera, of the two that a new track needs.

Two looks of different cameras make a pair when they are at most `Outlook.wait_s` apart. Looks that
are already ordered count: whoever they are expected to start need not be looked for again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Rig
from e3pose.model.overlap import overlap
from e3pose.select.kernels import people as kernels


@dataclass(frozen=True, slots=True, eq=False)
class Entrants:
    """Unexplained detections, as people that two cameras could start.

    Attributes:
        shares: `(num_entrants, num_cameras)` in [0, 1]: how likely each camera sees the person, as
            far as it overlooks what the camera sees that found them.
        others: `(num_entrants, num_cameras)` in [0, 1]: how likely *another* camera than this one
            sees the person at most `wait_s` before the slot.
        weights: `(num_entrants,)` people, less those whom ordered looks are expected to start.
    """

    shares: Floats
    others: Floats
    weights: Floats

    @classmethod
    def none(cls, num_cameras: int) -> Entrants:
        """Return the value for when every detection is explained."""
        return cls(np.zeros((0, num_cameras)), np.zeros((0, num_cameras)), np.zeros(0))

    def starts(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` number of people that sets of cameras are expected to start.

        Args:
            subsets: `(num_subsets, num_cameras)`.
        """
        people = np.empty(len(subsets))
        kernels.started(self.shares, self.others, self.weights, subsets, people)
        return people


def expected_entrants(
    rig: Rig,
    unexplained: NDArray[np.int64],
    age_s: Floats,
    wait_s: float,
    interval_s: float,
    ordered: Flags,
) -> Entrants:
    """Compute the tracks that cameras could start in the first slot without orders.

    Args:
        rig: the cameras.
        unexplained: `(num_cameras,)` detections of each camera's newest look that no track
            explains, while they wait.
        age_s: `(num_cameras,)` how old these will be in that slot.
        wait_s: how far apart two looks may be to make a pair.
        interval_s: seconds per slot.
        ordered: `(num_ordered, num_cameras)` cameras of the next slots.
    """
    sources = [camera for camera, waiting in enumerate(unexplained.tolist()) if waiting]
    if not sources:
        return Entrants.none(len(rig))
    shares = reach(rig)[sources]
    others, weights = np.zeros_like(shares), unexplained[sources].astype(np.float64)
    ages_s = np.empty(1 + len(ordered))
    ages_s[1:] = interval_s * np.arange(len(ordered), 0, -1)
    seen = np.empty((1 + len(ordered), len(rig)))
    for row, source in enumerate(sources):
        ages_s[0] = age_s[source]
        seen[0], seen[1:] = 0.0, shares[row] * ordered
        seen[0, source] = 1.0
        weights[row] *= 1 - kernels.pair_views(seen, ages_s, wait_s, others[row])
    return Entrants(shares, others, weights)


@lru_cache(maxsize=64)
def reach(rig: Rig) -> Floats:
    """Return `overlap`, with 1 on the diagonal: a camera sees all that it sees."""
    return np.maximum(overlap(rig), np.eye(len(rig)))
