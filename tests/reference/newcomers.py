"""People who have just come in, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Rig
from e3pose.model.overlap import overlap
from e3pose.select.expected_information import FIRST_VIEW, Entrants


def starts(entrants: Entrants, subsets: Flags) -> Floats:
    """See `Entrants.starts`."""
    total = np.zeros(len(subsets))
    for shares, others, weight in zip(
        entrants.shares, entrants.others, entrants.weights, strict=True
    ):
        seen = subsets * shares
        highest = np.sort(seen, axis=1)[:, -2:]
        together = highest.prod(axis=1) if subsets.shape[1] > 1 else 0.0
        with_partner = (seen * others).max(axis=1)
        first = FIRST_VIEW * highest[:, -1]
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
    """See `e3pose.select.expected_information.expected_entrants`."""
    sources = np.flatnonzero(unexplained)
    if len(sources) == 0:
        return Entrants.none(len(rig))
    shares = np.maximum(overlap(rig), np.eye(len(rig)))[sources]
    others, weights = np.zeros_like(shares), unexplained[sources].astype(np.float64)
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
                others[row] = np.maximum(others[row], _of_others(seen))
        weights[row] *= 1 - met
    return Entrants(shares, others, weights)


def _pair(first: Floats, second: Floats) -> float:
    """Return the largest product of two different cameras."""
    products = np.outer(first, second)
    np.fill_diagonal(products, 0.0)
    return float(products.max())


def _of_others(seen: Floats) -> Floats:
    """Return for each camera the highest of the other ones."""
    others = np.where(np.eye(len(seen), dtype=bool), 0.0, seen)
    return np.asarray(others.max(axis=1))
