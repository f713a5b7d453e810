"""Expected Fisher information of each camera about all people in a future slot.

A joint at p with covariance P, seen by the cameras of a set S, is expected to be left with

    L(S) = P^-1 + sum_{c in S} w_c J_c' J_c,    w_c = delivered * visible * new / sigma_c^2

where J_c is the derivative of the projection. Between the newest slot and the one that is decided
lie slots whose cameras are already ordered: P is what their views are expected to leave of what is
known, each at its own time. Method: `docs/explanation/camera-selection.md`.

Newcomers are people detected by one camera, of the two that a new track needs. Two looks of
different cameras make a pair when they are at most `Outlook.wait_s` apart. Looks that are already
ordered count: whoever they are expected to start need not be looked for again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.base import Expected, Outlook
from e3pose.estimate.filter.bias import MemoryTerms, memory_terms
from e3pose.estimate.filter.lasting import MOST, excess_of
from e3pose.estimate.filter.repeated_errors import MOST_LASTING_M, MOST_M, STAYS
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.model.overlap import overlap
from e3pose.select.kernels import foresight as kernels

ON_DIAGONAL = [0, 3, 5]  # layout: of the six entries of a symmetric matrix
# tuned: share | simulated, as for an entrant | 0.75 finds no more people
FIRST_VIEW = 0.5  # of a start: one view is worth half, a later one the rest


@dataclass(frozen=True, slots=True, eq=False)
class Foresight:
    """The information about every joint before a slot and that each camera would add.

    Symmetric matrices are stored as their six upper entries, in 1/m2.

    Attributes:
        outlook: what is known of the people.
        prior: `(num_tracks, num_joints, 6)` before any view of the slot.
        views: `(num_cameras, num_tracks, num_joints, 6)` that each camera would add if its errors
            were new ones.
        counted: `(num_cameras, num_tracks)` share of that which the estimator counts, less the
            sooner the camera looks again.
        new: `(num_cameras, num_tracks)` share of that which is worth something: less than what is
            counted where a camera looks again, for errors last that the estimator does not learn.
        weights: `(num_tracks,)` weight of each person. One whom no camera showed recently may be
            away, so the information that cameras would have about them counts for less.
        entrants: people who are not tracked yet.
    """

    outlook: Outlook
    prior: Floats
    views: Floats
    counted: Floats
    new: Floats
    weights: Floats
    entrants: Entrants

    @property
    def people(self) -> Expected:
        """The people whom it is about."""
        return self.outlook.expected

    def information(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` nats a joint that sets of cameras are expected to add.

        That is the weighted mean over people and joints of half the growth of log det L: a sum of
        functions of diminishing returns, so that a greedy choice is within 1 - 1/e of the best.

        Args:
            subsets: `(num_subsets, num_cameras)`.
        """
        nats = np.empty(len(subsets))
        kernels.information(self.prior, self.views, self.new, self.weights, subsets, nats)
        return nats

    def over_seconds(self) -> Foresight:
        """Return the foresight of seconds in which the same cameras look again and again.

        What is known now is gone by then, and every look of a camera repeats its errors: however
        many there are, they count once.
        """
        share = self.outlook.bias_share
        # What all looks of a camera repeat, over the variance of a keypoint; and how little is
        # known of a joint along an axis on which no camera tells anything.
        repeats = min(STAYS * _terms(self.outlook.memory).most + share, 1.0)
        free_m = MOST_M + (MOST_LASTING_M - MOST_M) * excess_of(share) / MOST
        free = np.zeros_like(self.prior)
        free[..., ON_DIAGONAL] = 1 / free_m**2
        once = np.full_like(self.counted, 1 / repeats)
        return replace(self, prior=free, counted=once, new=once)

    def gains_nats(self, chosen: Flags) -> Floats:
        """Return `(num_cameras,)` nats a joint that each camera adds to the others of a set.

        Args:
            chosen: `(num_cameras,)`.
        """
        nats = np.empty(len(chosen))
        kernels.gains(self.prior, self.views, self.new, self.weights, chosen, nats)
        return nats

    def expected_error_m(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` metres: the mean distance of shown joints from the truth.

        It is what the estimator will state after the views, and NaN when nobody is shown.
        """
        error_m = np.empty(len(subsets))
        kernels.errors(
            self.prior, self.views, self.counted, self.people.confirmed, subsets, error_m
        )
        return error_m


def foresee(
    rig: Rig, outlook: Outlook, interval_s: float, ordered: Flags | None = None
) -> Foresight:
    """Compute the information that each camera would add in the slot after `ordered`.

    What is known is carried through the slots in between: each adds its process noise, and the
    views that are ordered for it add their expected information, at their own time.

    Args:
        rig: the cameras.
        outlook: of the slot to be decided.
        interval_s: seconds per slot.
        ordered: `(num_ordered, num_cameras)` from the next slot to the one before that which is
            decided: the cameras that are already ordered; None where it is the next one.
    """
    if ordered is None:
        ordered = np.zeros((0, len(rig)), dtype=bool)
    terms = _terms(outlook.memory)
    num_tracks, num_joints, _ = outlook.expected.joints_m.shape
    per_view, per_person = (len(rig), num_tracks), (num_tracks, num_joints, 6)
    foreseen = kernels.Foreseen(
        views=np.empty((len(rig), *per_person)),
        prior=np.empty(per_person),
        counted=np.empty(per_view),
        new=np.empty(per_view),
        weights=np.empty(num_tracks),
    )
    kernels.foresee_views(
        Expected._make(map(np.ascontiguousarray, outlook.expected)),
        rig.projections,
        rig.image_sizes,
        terms,
        interval_s,
        ordered if outlook.has_memory else np.zeros_like(ordered),
        foreseen,
    )
    return Foresight(
        outlook=outlook,
        entrants=expected_entrants(
            rig,
            outlook.unexplained,
            outlook.unexplained_s + (len(ordered) + 1) * interval_s,
            outlook.wait_s,
            interval_s,
            ordered,
        ),
        **foreseen._asdict(),
    )


@lru_cache(maxsize=64)
def _terms(memory: ErrorMemory) -> MemoryTerms:
    """Return the filter's constants for an error memory."""
    return memory_terms(memory)


class Entrants(NamedTuple):
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
        started(self, subsets, people)
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
        weights[row] *= 1 - pair_views(seen, ages_s, wait_s, others[row])
    return Entrants(shares, others, weights)


@lru_cache(maxsize=64)
def reach(rig: Rig) -> Floats:
    """Return `overlap`, with 1 on the diagonal: a camera sees all that it sees."""
    return np.maximum(overlap(rig), np.eye(len(rig)))


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
def started(entrants: Entrants, subsets: Flags, people: Floats) -> None:
    """Fill `people` `(num_subsets,)` with `Entrants.starts`."""
    shares, others, weights = entrants.shares, entrants.others, entrants.weights
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
