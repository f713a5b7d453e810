"""Expected information of cameras, and expected errors of sets of cameras, as kernels.

Symmetric 3 x 3 matrices are their six upper entries, xx, xy, xz, yy, yz and zz.

The detection rate by place says where a camera seldom detects people, as behind walls. A rig's
geometry says which places lie inside an image, but not what stands between. The estimator counts
which of a camera's looks at people who were there showed them, by place (`filter.blindness`), and
keeps that longer than any track: somebody new, or somebody who comes round a corner, is not
expected of a camera that showed nobody there before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.base import Expected
from e3pose.estimate.filter.bias import MemoryTerms, inflation, worth_inflation
from e3pose.estimate.filter.carry import carry
from e3pose.model.projection import MIN_DEPTH_M, shown_at

# Of the information about a joint that lies in the box of somebody nearer. A box is about half
# filled by its body.
# tuned: share | by reasoning: a box is about half filled | 0: within noise by the labels of Shelf
BEHIND_SHARE = 0.5
MOST_PRODUCT = 1e200  # numerics: of ratios before their logarithm is taken
# A view in plain sight knows a joint to about 2 cm, an unseen one may be off by 20 cm: a view adds
# 100 times the information there was.
# tuned: ratio | by reasoning: 20 cm over 2 cm, squared | by the truth of six scenes half: 3 % more
#   error; twice: the same; next to none: 1.5 % more
INFORMATION_RATIO = 100.0


class Foreseen(NamedTuple):
    """Expected information of each camera, as in `Foresight`."""

    views: Floats  # (num_cameras, num_tracks, num_joints, 6)
    prior: Floats  # (num_tracks, num_joints, 6)
    counted: Floats  # (num_cameras, num_tracks)
    new: Floats  # (num_cameras, num_tracks)
    weights: Floats  # (num_tracks,)


@kernel
def foresee_views(
    expected: Expected,
    projections: Floats,
    sizes: Floats,
    terms: MemoryTerms,
    interval_s: float,
    carried: Flags,
    foreseen: Foreseen,
) -> None:
    """Fill `foreseen`.

    Less is expected of cameras that seldom show somebody where people will be.

    Args:
        expected: people.
        projections: `(num_cameras, 3, 4)`.
        sizes: `(num_cameras, 2)` width and height.
        terms: how the filter counts repeated looks.
        interval_s: seconds per slot.
        carried: `(num_ordered, num_cameras)` the looks that will be known by then.
        foreseen: filled.
    """
    views, weights = foreseen.views, foreseen.weights
    weights[:] = 0.0
    for camera in range(len(views)):
        _expect(
            expected.joints_m,
            projections[camera],
            sizes[camera],
            expected.sigma_px[camera],
            expected.delivered[:, camera],
            expected.shows[:, camera],
            views[camera],
            weights,
        )
    since_s = expected.last_seen_s.copy()
    steps = (
        expected.covariance,
        expected.drift_m2ps3,
        expected.velocity_lasts_s,
        interval_s,
        terms,
    )
    carry(*steps, carried, views, since_s, foreseen.prior)
    for camera in range(len(views)):
        for track in range(len(weights)):
            foreseen.counted[camera, track] = 1.0 / inflation(since_s[track, camera], terms)
            foreseen.new[camera, track] = 1.0 / worth_inflation(since_s[track, camera], terms)


@kernel
def _expect(
    joints_m: Floats,
    projection: Floats,
    size: Floats,
    sigma_px: float,
    delivered: Floats,
    shows: Floats,
    information: Floats,
    weights: Floats,
) -> None:
    """Fill the expected `information` of a camera `(num_tracks, num_joints, 6)`.

    Raises `weights` to what it delivers. Joints outside the image or behind others count less.
    """
    num_tracks, num_joints, _ = joints_m.shape
    pixels = np.empty((num_tracks, num_joints, 2))
    inside = np.empty((num_tracks, num_joints), np.bool_)
    boxes, depths = np.empty((num_tracks, 4)), np.empty(num_tracks)
    for track in range(num_tracks):
        at, row = pixels[track], information[track]
        depths[track] = _project(
            joints_m[track], projection, size, at, inside[track], boxes[track], row
        )
    for track in range(num_tracks):
        expected = delivered[track] * worth(shows[track])
        weights[track] = max(weights[track], expected)
        weight = expected / sigma_px**2
        for joint in range(num_joints):
            u, v = pixels[track, joint, 0], pixels[track, joint, 1]
            share = _in_front(u, v, depths[track], boxes, depths)
            for entry in range(6):
                information[track, joint, entry] *= share * weight * inside[track, joint]


@kernel
def _project(
    joints_m: Floats,
    projection: Floats,
    size: Floats,
    pixels: Floats,
    inside: Flags,
    box: Floats,
    information: Floats,
) -> float:
    """Project a person into a camera; return the mean depth of the joints.

    Fills `pixels`, `inside` the image, `box` (left, top, right, bottom of all joints) and
    `information` `(num_joints, 6)`: J' J of the derivative of the projection.
    """
    left, top, right, bottom, total = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for joint in range(len(joints_m)):
        depth, u, v, ux, uy, uz, vx, vy, vz = shown_at(
            projection, joints_m[joint, 0], joints_m[joint, 1], joints_m[joint, 2]
        )
        total += depth
        pixels[joint, 0], pixels[joint, 1] = u, v
        inside[joint] = depth > MIN_DEPTH_M and 0 < u < size[0] and 0 < v < size[1]
        left, right = min(left, u), max(right, u)
        top, bottom = min(top, v), max(bottom, v)
        information[joint, 0] = ux * ux + vx * vx
        information[joint, 1] = ux * uy + vx * vy
        information[joint, 2] = ux * uz + vx * vz
        information[joint, 3] = uy * uy + vy * vy
        information[joint, 4] = uy * uz + vy * vz
        information[joint, 5] = uz * uz + vz * vz
    box[0], box[1], box[2], box[3] = left, top, right, bottom
    return total / len(joints_m)


@kernel
def _in_front(u: float, v: float, depth: float, boxes: Floats, depths: Floats) -> float:
    """Return `BEHIND_SHARE` if a nearer person's box covers (u, v), else 1."""
    for other in range(len(depths)):
        if 0 < depths[other] < depth:
            box = boxes[other]
            if box[0] < u < box[2] and box[1] < v < box[3]:
                return BEHIND_SHARE
    return 1.0


@kernel
def information(
    prior: Floats, views: Floats, new: Floats, weights: Floats, subsets: Flags, nats: Floats
) -> None:
    """Fill `nats` `(num_subsets,)`: expected information of sets of cameras, see `Foresight`.

    The innermost loops run over the joints of a person, which fills vector registers.

    Args:
        prior: `(num_tracks, num_joints, 6)`.
        views: `(num_cameras, num_tracks, num_joints, 6)`.
        new: `(num_cameras, num_tracks)` share of `views` that is new.
        weights: `(num_tracks,)` of people.
        subsets: `(num_subsets, num_cameras)`.
        nats: filled, nats per joint.
    """
    num_tracks, num_joints, _ = prior.shape
    first, after = np.empty((6, num_joints)), np.empty((6, num_joints))
    added = np.empty((len(views), 6, num_joints))
    before, dets = np.empty(num_joints), np.empty(num_joints)
    weight = 0.0
    nats[:] = 0.0
    for track in range(num_tracks):
        weight += weights[track]
        for joint in range(num_joints):
            for entry in range(6):
                first[entry, joint] = prior[track, joint, entry]
        for camera in range(len(views)):  # in the order of memory
            share = new[camera, track]
            for joint in range(num_joints):
                for entry in range(6):
                    added[camera, entry, joint] = share * views[camera, track, joint, entry]
        _determinants(first, before)
        for row in range(len(subsets)):
            _add_all(first, added, subsets[row], after)
            _determinants(after, dets)
            for joint in range(num_joints):
                dets[joint] /= before[joint]
            logs, product = 0.0, 1.0
            for joint in range(num_joints):
                product *= dets[joint]
                if product > MOST_PRODUCT:
                    logs += math.log(product)
                    product = 1.0
            nats[row] += weights[track] * (logs + math.log(product))
    for row in range(len(subsets)):
        nats[row] = nats[row] / max(weight * num_joints, 1e-9) / 2


@kernel
def gains(
    prior: Floats, views: Floats, new: Floats, weights: Floats, chosen: Flags, nats: Floats
) -> None:
    """Fill `nats` `(num_cameras,)`: information that each camera adds to the `chosen` ones."""
    num_cameras = len(chosen)
    subsets, found = np.empty((num_cameras + 1, num_cameras), np.bool_), np.empty(num_cameras + 1)
    for row in range(num_cameras + 1):
        for camera in range(num_cameras):
            subsets[row, camera] = chosen[camera] != (row == camera)
    information(prior, views, new, weights, subsets, found)
    for camera in range(num_cameras):
        change = found[camera] - found[num_cameras]
        nats[camera] = -change if chosen[camera] else change


@kernel
def _add_all(first: Floats, added: Floats, subset: Flags, after: Floats) -> None:
    """Fill `after` `(6, num_joints)`: prior information plus that of a set of cameras."""
    for entry in range(6):
        for joint in range(first.shape[1]):
            after[entry, joint] = first[entry, joint]
    for camera in range(len(subset)):
        if subset[camera]:
            for entry in range(6):
                for joint in range(first.shape[1]):
                    after[entry, joint] += added[camera, entry, joint]


@kernel
def _determinants(m: Floats, dets: Floats) -> None:
    """Fill `dets` `(num_joints,)` of matrices `(6, num_joints)`."""
    xx, xy, xz, yy, yz, zz = m[0], m[1], m[2], m[3], m[4], m[5]
    for joint in range(len(dets)):
        minor = yy[joint] * zz[joint] - yz[joint] * yz[joint]
        across = xy[joint] * (xy[joint] * zz[joint] - yz[joint] * xz[joint])
        inner = xy[joint] * yz[joint] - yy[joint] * xz[joint]
        dets[joint] = xx[joint] * minor - across + xz[joint] * inner


@kernel
def errors(
    prior: Floats, views: Floats, counted: Floats, confirmed: Flags, subsets: Flags, error_m: Floats
) -> None:
    """Fill `error_m` `(num_subsets,)`: the mean expected joint error of confirmed people.

    NaN where nobody is. Other arguments are those of `information`.
    """
    num_tracks, num_joints, _ = prior.shape
    after = np.empty(6)
    for row in range(len(subsets)):
        total, count = 0.0, 0
        for track in range(num_tracks):
            if confirmed[track]:
                for joint in range(num_joints):
                    _add(
                        prior[track, joint],
                        views[:, track, joint],
                        counted[:, track],
                        subsets[row],
                        after,
                    )
                    total += _distance(after)
                    count += 1
        error_m[row] = total / count if count else np.nan


@kernel
def stated_error(covariance_m2: Floats) -> float:
    """Return the mean distance expected of joints `(num_persons, num_joints, 3, 3)`; NaN of none.

    Joints whose covariance is NaN do not count.
    """
    sum_m, count = 0.0, 0
    for person in range(covariance_m2.shape[0]):
        for joint in range(covariance_m2.shape[1]):
            total, squared = 0.0, 0.0
            for a in range(3):
                total += covariance_m2[person, joint, a, a]
                for b in range(3):
                    squared += covariance_m2[person, joint, a, b] ** 2
            distance_m = _mean_distance(total, squared)
            if math.isfinite(distance_m):
                sum_m += distance_m
                count += 1
    return sum_m / count if count else np.nan


@kernel
def _add(prior: Floats, views: Floats, share: Floats, subset: Flags, after: Floats) -> None:
    """Fill `after` `(6,)`: the information about a joint with the views of a set of cameras."""
    for entry in range(6):
        after[entry] = prior[entry]
    for camera in range(len(subset)):
        if subset[camera]:
            for entry in range(6):
                after[entry] += share[camera] * views[camera, entry]


@kernel
def _det(m: Floats) -> float:
    minor = m[3] * m[5] - m[4] * m[4]
    across = m[1] * (m[1] * m[5] - m[4] * m[2])
    return float(m[0] * minor - across + m[2] * (m[1] * m[4] - m[3] * m[2]))


@kernel
def _distance(m: Floats) -> float:
    """Return the expected distance for an information matrix, as `model.uncertainty` has it."""
    minors = m[0] * m[3] - m[1] * m[1] + m[0] * m[5] - m[2] * m[2] + m[3] * m[5] - m[4] * m[4]
    det = _det(m)
    total = minors / det  # the trace of the inverse
    squared = total**2 - 2 * (m[0] + m[3] + m[5]) / det  # the trace of its square
    return _mean_distance(total, squared)


@kernel
def _mean_distance(total: float, squared: float) -> float:
    """Return the mean of a distance by the traces of its covariance and of the square of that."""
    degrees = total**2 / squared
    # The mean of a chi distribution: sqrt(2) Gamma((k + 1) / 2) / Gamma(k / 2).
    rising = math.exp(math.lgamma(degrees / 2 + 0.5) - math.lgamma(degrees / 2))
    return math.sqrt(2 * total / degrees) * rising


@kernel
def worth(shows: float) -> float:
    """Return the value of a camera, as a share, from its probability to show a person.

    A camera that shows somebody with probability p and otherwise nothing is worth p log(1 + W) nats
    where one that always shows W times what is known is worth log(1 + W): as much as one that
    always shows ((1 + W)^p - 1) / W of that.
    """
    return float(((1.0 + INFORMATION_RATIO) ** shows - 1.0) / INFORMATION_RATIO)
