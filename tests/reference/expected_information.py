"""What cameras would add to what is known, in plain numpy: of all people and joints at once."""

from __future__ import annotations

import numpy as np
from tests.reference.filter_bias import inflation, worth_inflation

from e3pose.base.arrays import Flags, Floats
from e3pose.estimate.base import Outlook
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.carry import carry
from e3pose.model.camera import Rig
from e3pose.model.projection import MIN_DEPTH_M, project
from e3pose.model.uncertainty import mean_distance
from e3pose.select.expected_information import Entrants, Foresight
from e3pose.select.kernels.foresight import (
    BEHIND_M,
    BEHIND_SHARE,
    INFORMATION_RATIO,
)

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix, as stored here


def foresee(rig: Rig, outlook: Outlook, interval_s: float, ordered: Flags) -> Foresight:
    """See `e3pose.select.expected_information.foresee`; without entrants."""
    pixels, depth, jacobian = project(outlook.expected.joints_m, rig.projections)
    inside, in_front = _inside(rig, pixels, depth), _in_front(pixels, depth)
    weight = inside * in_front / outlook.expected.sigma_px[:, None, None] ** 2
    likely = ((1 + INFORMATION_RATIO) ** outlook.expected.shows - 1) / INFORMATION_RATIO
    delivered = outlook.expected.delivered * likely
    weight = weight * delivered.T[..., None]
    full = np.stack([(jacobian[..., a] * jacobian[..., b]).sum(axis=-1) for a, b in UPPER], axis=-1)
    full = full * weight[..., None]  # (num_cameras, num_tracks, num_joints, 6)
    terms = memory_terms(outlook.memory)
    prior, since_s = np.empty(full.shape[1:]), outlook.expected.last_seen_s.copy()
    carry(
        outlook.expected.covariance,
        outlook.expected.drift_m2ps3,
        outlook.expected.velocity_lasts_s,
        interval_s,
        terms,
        ordered if outlook.has_memory else np.zeros_like(ordered),
        full,
        since_s,
        prior,
    )
    return Foresight(
        outlook=outlook,
        prior=prior,
        views=full,
        counted=1 / inflation(since_s.T, terms),
        new=1 / worth_inflation(since_s.T, terms),
        weights=delivered.max(axis=1, initial=0.0),
        entrants=Entrants.none(len(rig)),
    )


def information(foresight: Foresight, subsets: Flags) -> Floats:
    """See `Foresight.information`."""
    after = _after(foresight, foresight.new, subsets)
    gain = np.log(_det(after)) - np.log(_det(foresight.prior.reshape(-1, 6)))
    weights = np.repeat(foresight.weights, foresight.prior.shape[1])
    return np.asarray(gain @ weights / max(weights.sum(), 1e-9) / 2)


def expected_error_m(foresight: Foresight, subsets: Flags) -> Floats:
    """See `Foresight.expected_error_m`."""
    shown = np.repeat(foresight.people.confirmed, foresight.prior.shape[1])
    return np.asarray(
        _distance(_after(foresight, foresight.counted, subsets)[:, shown]).mean(axis=-1)
    )


def _after(foresight: Foresight, shares: Floats, subsets: Flags) -> Floats:
    views = (foresight.views * shares[..., None, None]).reshape(subsets.shape[1], -1)
    added = subsets.astype(np.float64) @ views
    return np.asarray((added + foresight.prior.reshape(-1)).reshape(len(subsets), -1, 6))


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
