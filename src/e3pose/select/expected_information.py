"""Expected Fisher information of each camera about all people in a future slot.

A joint at p with covariance P, seen by the cameras of a set S, is expected to be left with

    L(S) = P^-1 + sum_{c in S} w_c J_c' J_c,    w_c = delivered * visible * new / sigma_c^2

where J_c is the derivative of the projection. Between the newest slot and the one that is decided
lie slots whose cameras are already ordered: P is what their views are expected to leave of what is
known, each at its own time. Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.estimate.base import Expected, Outlook
from e3pose.estimate.filter.bias import MemoryTerms, memory_terms
from e3pose.estimate.filter.lasting import MOST, excess_of
from e3pose.estimate.filter.repeated_errors import MOST_LASTING_M, MOST_M, STAYS
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.select.kernels import foresight as kernels
from e3pose.select.newcomers import Entrants, expected_entrants

ON_DIAGONAL = [0, 3, 5]  # layout: of the six entries of a symmetric matrix


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
        nats = np.zeros(len(subsets))
        if self.prior.size:
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
        nats = np.zeros(len(chosen))
        if self.prior.size:
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
