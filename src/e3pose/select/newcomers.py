"""People who have just come in: one camera saw them, the estimator needs two to start them.

Two looks of different cameras make a pair when they are at most `Outlook.wait_s` apart. Looks that
are already ordered count: whoever they are expected to start need not be looked for again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Of a start: what one look is worth that leaves the other half to a later one.
FIRST_LOOK = 0.5
OVERLAP_DEPTHS_M = np.arange(1.0, 9.0, 0.5)
PERSON_M = 2.0  # up to which height people are seen


@dataclass(frozen=True, slots=True, eq=False)
class Entrants:
    """Detections that no track explains, as people whom two cameras could start.

    Attributes:
        shares: `(num_entrants, num_cameras)` in [0, 1]: how likely each camera sees the person, as
            far as it overlooks what the camera sees that found them.
        partners: `(num_entrants, num_cameras)` in [0, 1]: how likely *another* camera than this one
            sees the person at most `wait_s` before the slot.
        weights: `(num_entrants,)` people, less those whom ordered looks are expected to start.
    """

    shares: Floats
    partners: Floats
    weights: Floats

    @classmethod
    def nobody(cls, num_cameras: int) -> Entrants:
        """Return what is expected where every detection is explained."""
        return cls(np.zeros((0, num_cameras)), np.zeros((0, num_cameras)), np.zeros(0))

    def starts(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` people whom sets of cameras are expected to start.

        Args:
            subsets: `(num_subsets, num_cameras)`.
        """
        total = np.zeros(len(subsets))
        for shares, partners, weight in zip(self.shares, self.partners, self.weights, strict=True):
            seen = subsets * shares
            highest = np.sort(seen, axis=1)[:, -2:]
            together = highest.prod(axis=1) if subsets.shape[1] > 1 else 0.0
            with_partner = (seen * partners).max(axis=1)
            first = FIRST_LOOK * highest[:, -1]
            total += weight * np.maximum(np.maximum(together, with_partner), first)
        return total


def expected_entrants(
    rig: Rig,
    unexplained: NDArray[np.int64],
    age_s: Floats,
    wait_s: float,
    interval_s: float,
    ordered: Flags,
) -> Entrants:
    """Work out whom cameras could start in the slot after those that are ordered.

    Args:
        rig: the cameras.
        unexplained: `(num_cameras,)` detections of each camera's newest look that no track
            explains, while they wait.
        age_s: `(num_cameras,)` how old these will be in that slot.
        wait_s: how far apart two looks may be to make a pair.
        interval_s: seconds per slot.
        ordered: `(num_ordered, num_cameras)` cameras of the next slots.
    """
    sources = np.flatnonzero(unexplained)
    if len(sources) == 0:
        return Entrants.nobody(len(rig))
    shares = np.maximum(overlap(rig), np.eye(len(rig)))[sources]
    partners, weights = np.zeros_like(shares), unexplained[sources].astype(np.float64)
    ages_s = [interval_s * (len(ordered) - ahead) for ahead in range(len(ordered))]
    for row, source in enumerate(sources):
        looks = [(float(age_s[source]), np.eye(len(rig))[source])]
        looks += [
            (age, shares[row] * cameras) for age, cameras in zip(ages_s, ordered, strict=True)
        ]
        met = 0.0
        for index, (age, seen) in enumerate(looks):
            recent = [other for earlier, other in looks[:index] if earlier - age <= wait_s]
            met = max(met, _pair(seen, np.max([seen, *recent], axis=0)))
            if age <= wait_s:
                partners[row] = np.maximum(partners[row], _of_others(seen))
        weights[row] *= 1 - met
    return Entrants(shares, partners, weights)


def _pair(first: Floats, second: Floats) -> float:
    """Return the largest product of two different cameras."""
    products = np.outer(first, second)
    np.fill_diagonal(products, 0.0)
    return float(products.max())


def _of_others(seen: Floats) -> Floats:
    """Return for each camera the highest of the other ones."""
    others = np.where(np.eye(len(seen), dtype=bool), 0.0, seen)
    return np.asarray(others.max(axis=1))


@lru_cache(maxsize=8)
def overlap(rig: Rig) -> Floats:
    """Return `(num_cameras, num_cameras)`: how much of what one camera (row) sees another sees too.

    The share of points along the rays of its image, at heights of people; 0 on the diagonal.
    """
    share = np.zeros((len(rig), len(rig)))
    for row, camera in enumerate(rig.cameras):
        width, height = camera.image_size
        u, v = np.meshgrid(np.linspace(0.1, 0.9, 7) * width, np.linspace(0.1, 0.9, 5) * height)
        rays = camera.rays(np.stack([u.ravel(), v.ravel()], axis=-1))
        points = camera.center_m + rays[:, None] * OVERLAP_DEPTHS_M[:, None]
        points = points[(points[..., 2] > 0) & (points[..., 2] < PERSON_M)]
        if len(points):
            share[row] = [other.sees(points).mean() for other in rig.cameras]
    np.fill_diagonal(share, 0.0)
    return share
