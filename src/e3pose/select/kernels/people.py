"""Newcomers and hidden people that sets of cameras would show."""

from __future__ import annotations

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel

# tuned: share | simulated, as for an entrant: 0.75 is no better | not measured
FIRST_VIEW = 0.5  # of a start: one view is worth half, a later one the rest


@kernel
def pair_views(
    seen: Floats,
    ages_s: Floats,
    wait_s: float,
    others: Floats,
) -> float:
    """Return the probability that two of the `seen` views start a track; fill `others`.

    Args:
        seen: `(num_views, num_cameras)` how likely each camera sees the person at each time.
        ages_s: `(num_views,)` before the slot, falling.
        wait_s: how far apart two views may be to make a pair.
        others: `(num_cameras,)` filled: how likely another camera sees the person at most
            `wait_s` before the slot.
    """
    num_views, num_cameras = seen.shape
    met = 0.0
    for camera in range(num_cameras):
        others[camera] = 0.0
    for view in range(num_views):
        for first in range(num_cameras):
            for second in range(num_cameras):
                if first == second:
                    continue
                if ages_s[view] <= wait_s:
                    others[first] = max(others[first], seen[view, second])
                other = seen[view, second]
                for earlier in range(view):
                    if ages_s[earlier] - ages_s[view] <= wait_s:
                        other = max(other, seen[earlier, second])
                met = max(met, seen[view, first] * other)
    return met


@kernel
def started(
    shares: Floats, others: Floats, weights: Floats, subsets: Flags, people: Floats
) -> None:
    """Fill `people` `(num_subsets,)`; other arguments as in `newcomers.Entrants`."""
    for row in range(len(subsets)):
        people[row] = 0.0
        for entrant in range(len(weights)):
            first, second, paired = 0.0, 0.0, 0.0
            for camera in range(shares.shape[1]):
                if subsets[row, camera]:
                    seen = shares[entrant, camera]
                    second = max(second, min(first, seen))
                    first = max(first, seen)
                    paired = max(paired, seen * others[entrant, camera])
            best = max(max(first * second, paired), FIRST_VIEW * first)
            people[row] += weights[entrant] * best
