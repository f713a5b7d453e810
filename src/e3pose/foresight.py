"""What each camera is expected to tell about everybody in a slot to come: Fisher information.

A joint at p with covariance P, seen by the cameras of a set S, is expected to be left with

    L(S) = P^-1 + sum_{c in S} w_c J_c' J_c,    w_c = delivered * visible * fresh / sigma_c^2

where J_c is the derivative of the projection. `docs/choice.md` has the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig
from e3pose.filter.outlook import Outlook
from e3pose.filter.update import MIN_DEPTH_M, project
from e3pose.uncertainty import mean_distance

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Errors of one view persist: their autocorrelation is that of 10 % white noise, 45 % with a memory
# of 0.1 s and 45 % with one of 2.5 s, measured on detections against a smoother, without labels.
PERSISTENT = ((0.45, 0.1), (0.45, 2.5))
# Of the information about a joint that lies in the box of somebody nearer. A box is about half
# filled by its body.
BEHIND_SHARE = 0.5
BEHIND_M = 0.1  # nearer than this two people stand side by side
OVERLAP_DEPTHS_M = np.arange(1.0, 9.0, 0.5)
PERSON_M = 2.0  # up to which height people are seen
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
            were new ones, which is what the estimator counts.
        fresh: `(num_cameras, num_tracks)` share of that which is new.
        weights: `(num_tracks,)` how much each person counts. Somebody whom no camera showed of late
            may not be there: that cameras would tell much if they were must not decide.
        entrants: `(num_cameras,)` people whom nobody knows yet and another camera showed, as far
            as each camera overlooks the ground where they may be.
    """

    track_ids: NDArray[np.int64]
    confirmed: Flags
    prior: Floats
    views: Floats
    fresh: Floats
    weights: Floats
    entrants: Floats

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
        after = self._after(subsets, self.views)[:, shown]
        return np.asarray(_distance(after).mean(axis=-1))

    def _after(self, subsets: Flags, views: Floats) -> Floats:
        """Return `(num_subsets, num_tracks * num_joints, 6)`."""
        added = subsets.astype(np.float64) @ views.reshape(len(views), -1)
        return np.asarray((added + self.prior.reshape(-1)).reshape(len(subsets), -1, 6))


def foresee(
    rig: Rig,
    outlook: Outlook,
    ordered: Sequence[tuple[float, Flags]] = (),
) -> Foresight:
    """Work out what each camera would add to what is expected.

    Args:
        rig: the cameras.
        outlook: of the slot to be decided.
        ordered: for every slot from now to that one whose cameras are already ordered, how many
            seconds it lies before it, and `(num_cameras,)` who detects in it.
    """
    pixels, depth, jacobian = project(outlook.joints_m, rig.projections)
    seen = _inside(rig, pixels, depth) * _in_front(pixels, depth)
    last_seen_s = outlook.last_seen_s.T
    weight = seen / outlook.sigma_px[:, None, None] ** 2
    weight = weight * outlook.delivered.T[..., None]
    full = np.stack([(jacobian[..., a] * jacobian[..., b]).sum(axis=-1) for a, b in UPPER], axis=-1)
    full = full * weight[..., None]  # (num_cameras, num_tracks, num_joints, 6)
    prior = _inverse(outlook.covariance_m2)
    for before_s, cameras in ordered:
        fresh = freshness(np.maximum(last_seen_s - before_s, 0.0)[cameras])
        prior = prior + np.einsum("ct,ctjk->tjk", fresh, full[cameras])
        last_seen_s = np.where(cameras[:, None], np.minimum(last_seen_s, before_s), last_seen_s)
    entrants = outlook.unexplained @ overlap(rig)
    return Foresight(
        track_ids=outlook.track_ids,
        confirmed=outlook.confirmed,
        prior=prior,
        views=full,
        fresh=freshness(last_seen_s),
        weights=outlook.delivered.max(axis=1, initial=0.0),
        entrants=entrants,
    )


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


def with_predictions(
    outlook: Outlook, now: Outlook, track_ids: NDArray[np.int64], joints_m: Floats, error_m: Floats
) -> Outlook:
    """Put a predictor's joints in the place of the estimator's own, where it states their error.

    What is not known of a joint now is not known of it later: the predictor's error comes on top.

    Args:
        outlook: the estimator's own.
        now: the same for the newest slot.
        track_ids: `(num_predicted,)` whose joints were predicted.
        joints_m: `(num_predicted, num_joints, 3)`.
        error_m: `(num_predicted, num_joints)` expected distance; NaN where the predictor states
            none, which leaves the estimator's own prediction.
    """
    _, rows, predicted = np.intersect1d(outlook.track_ids, track_ids, return_indices=True)
    known = np.isfinite(error_m[predicted]) & np.isfinite(joints_m[predicted]).all(axis=-1)
    if not known.any():
        return outlook
    one_axis = np.where(known, error_m[predicted], 0.0) / mean_distance(
        np.array(3.0), np.array(3.0)
    )
    spread = now.covariance_m2[rows] + (one_axis**2)[..., None, None] * np.eye(3)
    joints, covariance = outlook.joints_m.copy(), outlook.covariance_m2.copy()
    joints[rows] = np.where(known[..., None], joints_m[predicted], joints[rows])
    covariance[rows] = np.where(known[..., None, None], spread, covariance[rows])
    return replace(outlook, joints_m=joints, covariance_m2=covariance)


def freshness(last_seen_s: Floats) -> Floats:
    """Return the share of a view's information that is new, so long after the one before.

    Two measurements whose errors correlate by r tell (1 - r) / (1 + r) more than one.
    """
    r = sum(share * np.exp(-last_seen_s / lasts_s) for share, lasts_s in PERSISTENT)
    return np.asarray((1 - r) / (1 + r))


def _inside(rig: Rig, pixels: Floats, depth: Floats) -> Flags:
    sizes = np.array([camera.image_size for camera in rig.cameras], dtype=np.float64)
    inside = ((pixels > 0) & (pixels < sizes[:, None, None])).all(axis=-1)
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


def _inverse(covariance_m2: Floats) -> Floats:
    inverse = np.linalg.inv(covariance_m2)
    return np.stack([inverse[..., a, b] for a, b in UPPER], axis=-1)


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
