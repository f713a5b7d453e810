"""What each camera is expected to tell about everybody in a slot to come: Fisher information.

A joint at p with covariance P, seen by the cameras of a set S, is expected to be left with

    L(S) = P^-1 + sum_{c in S} w_c J_c' J_c,    w_c = delivered * visible * fresh / sigma_c^2

where J_c is the derivative of the projection. Between the newest slot and the one that is decided
lie slots whose cameras are already ordered: P is what their views are expected to leave of what is
known, each at its own time. Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.base import Outlook
from e3pose.estimate.filter.bias import inflation, memory_terms
from e3pose.estimate.filter.blindness import PLAIN
from e3pose.geometry.camera import Rig
from e3pose.geometry.projection import MIN_DEPTH_M, project
from e3pose.model.noise import ErrorMemory
from e3pose.model.uncertainty import mean_distance
from e3pose.select.hidden_people import HiddenPeople, expected_hidden
from e3pose.select.newcomers import Entrants, expected_entrants

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Of the information about a joint that lies in the box of somebody nearer. A box is about half
# filled by its body.
BEHIND_SHARE = 0.5
BEHIND_M = 0.1  # nearer than this two people stand side by side
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix, as stored here


@dataclass(frozen=True, slots=True, eq=False)
class Foresight:
    """The information about every joint before a slot and that each camera would add.

    Symmetric matrices are stored as their six upper entries, in 1/m2.

    Attributes:
        track_ids: `(num_tracks,)`.
        confirmed: `(num_tracks,)` who is shown.
        prior: `(num_tracks, num_joints, 6)` before any view of the slot.
        views: `(num_cameras, num_tracks, num_joints, 6)` that each camera would add if its errors
            were new ones.
        counted: `(num_cameras, num_tracks)` share of that which the estimator counts.
        fresh: `(num_cameras, num_tracks)` share of that which is new.
        weights: `(num_tracks,)` how much each person counts. Somebody whom no camera showed of late
            may not be there: that cameras would tell much if they were must not decide.
        entrants: people who are not tracked yet.
        hidden: people who are followed and hidden unless one more camera shows them.
    """

    track_ids: NDArray[np.int64]
    confirmed: Flags
    prior: Floats
    views: Floats
    counted: Floats
    fresh: Floats
    weights: Floats
    entrants: Entrants
    hidden: HiddenPeople

    def information(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` nats a joint that sets of cameras are expected to add.

        That is the weighted mean over people and joints of half the growth of log det L: a sum of
        functions of diminishing returns, so that a greedy choice is within 1 - 1/e of the best.

        Args:
            subsets: `(num_subsets, num_cameras)`.
        """
        if self.prior.size == 0:
            return np.zeros(len(subsets))
        after = self._after(subsets, self.views * self.fresh[..., None, None])
        gain = np.log(_det(after)) - np.log(_det(self.prior.reshape(-1, 6)))
        weights = np.repeat(self.weights, self.prior.shape[1])
        return np.asarray(gain @ weights / max(weights.sum(), 1e-9) / 2)

    def expected_error_m(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` metres: the mean distance of shown joints from the truth.

        It is what the estimator will state after the views, and NaN when nobody is shown.
        """
        shown = np.repeat(self.confirmed, self.prior.shape[1])
        if not shown.any():
            return np.full(len(subsets), np.nan)
        after = self._after(subsets, self.views * self.counted[..., None, None])[:, shown]
        return np.asarray(_distance(after).mean(axis=-1))

    def _after(self, subsets: Flags, views: Floats) -> Floats:
        """Return `(num_subsets, num_tracks * num_joints, 6)`."""
        added = subsets.astype(np.float64) @ views.reshape(len(views), -1)
        return np.asarray((added + self.prior.reshape(-1)).reshape(len(subsets), -1, 6))


def foresee(
    rig: Rig, outlook: Outlook, interval_s: float, ordered: Flags | None = None
) -> Foresight:
    """Work out what each camera would add to what is expected of the slot after `ordered`.

    What is known is carried through the slots in between: each adds its process noise, and the
    views that are ordered for it add what they are expected to tell, at their own time.

    Args:
        rig: the cameras.
        outlook: of the slot to be decided.
        interval_s: seconds per slot.
        ordered: `(num_ordered, num_cameras)` from the next slot to the one before that which is
            decided: the cameras that are already ordered; None where it is the next one.
    """
    from e3pose.estimate.filter.kernels.carry import carry

    pixels, depth, jacobian = project(outlook.joints_m, rig.projections)
    inside, in_front = _inside(rig, pixels, depth), _in_front(pixels, depth)
    seen = inside * in_front
    weight = seen / outlook.sigma_px[:, None, None] ** 2
    weight = weight * outlook.delivered.T[..., None]
    full = np.stack([(jacobian[..., a] * jacobian[..., b]).sum(axis=-1) for a, b in UPPER], axis=-1)
    full = full * weight[..., None]  # (num_cameras, num_tracks, num_joints, 6)
    if ordered is None:
        ordered = np.zeros((0, len(rig)), dtype=bool)
    prior = np.empty(full.shape[1:])
    terms = memory_terms(outlook.memory)
    since_s = outlook.last_seen_s.copy()
    carry(
        outlook.covariance,
        outlook.drift_m2ps3,
        outlook.velocity_lasts_s,
        interval_s,
        terms,
        ordered if outlook.remembers else np.zeros_like(ordered),
        full,
        since_s,
        prior,
    )
    return Foresight(
        track_ids=outlook.track_ids,
        confirmed=outlook.confirmed,
        prior=prior,
        views=full,
        counted=1 / inflation(since_s.T, terms),
        fresh=freshness(since_s.T, outlook.memory),
        weights=outlook.delivered.max(axis=1, initial=0.0),
        hidden=expected_hidden(outlook.needed, _shown(outlook, inside, in_front), ordered),
        entrants=expected_entrants(
            rig,
            outlook.unexplained,
            outlook.unexplained_s + (len(ordered) + 1) * interval_s,
            outlook.wait_s,
            interval_s,
            ordered,
        ),
    )


def freshness(last_seen_s: Floats, memory: ErrorMemory) -> Floats:
    """Return the share of a view's information that is new, so long after the one before.

    Two measurements whose errors correlate by r tell (1 - r) / (1 + r) more than one; r is the
    autocorrelation of the detector's errors.
    """
    r = memory.quick_share * np.exp(-last_seen_s / memory.quick_s)
    r = r + memory.lasting_share * np.exp(-last_seen_s / memory.lasting_s)
    return np.asarray((1 - r) / (1 + r))


def _shown(outlook: Outlook, inside: Flags, in_front: Floats) -> Floats:
    """Return `(num_cameras, num_tracks)`: how likely a look shows somebody who is there.

    As the filter counts: a view should show a person of whom enough joints lie inside the image.
    """
    from e3pose.estimate.filter.kernels.existence import INSIDE_JOINTS

    enough = inside.sum(axis=-1) >= INSIDE_JOINTS
    return np.asarray(PLAIN * outlook.shows.T * enough * in_front.mean(axis=-1))


def _inside(rig: Rig, pixels: Floats, depth: Floats) -> Flags:
    inside = ((pixels > 0) & (pixels < rig.image_sizes[:, None, None])).all(axis=-1)
    return np.asarray(inside & (depth > MIN_DEPTH_M))


def _in_front(pixels: Floats, depth: Floats) -> Floats:
    """Return `(num_cameras, num_tracks, num_joints)`: 1, or less behind the box of somebody."""
    low, high = pixels.min(axis=2), pixels.max(axis=2)  # (num_cameras, num_tracks, 2)
    others = (slice(None), None, None, slice(None))
    within = (pixels[:, :, :, None] > low[others]) & (pixels[:, :, :, None] < high[others])
    distance = depth.mean(axis=-1)
    nearer = (distance[:, None] < distance[..., None] - BEHIND_M) & (distance[:, None] > 0)
    hidden = (within.all(axis=-1) & nearer[:, :, None, :]).any(axis=-1)
    return np.where(hidden, BEHIND_SHARE, 1.0)


def _det(m: Floats) -> Floats:
    xx, xy, xz, yy, yz, zz = np.moveaxis(m, -1, 0)
    return np.asarray(
        xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    )


def _distance(information: Floats) -> Floats:
    """Return the expected distance for information matrices `(*batch, 6)`, in closed form."""
    xx, xy, xz, yy, yz, zz = np.moveaxis(information, -1, 0)
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    det = _det(information)
    total = minors / det  # the trace of the inverse
    squared = total**2 - 2 * (xx + yy + zz) / det  # the trace of its square
    return mean_distance(total, total**2 / squared)
