"""Propagate people through the slots whose cameras are already ordered."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import MemoryTerms, inflation


@kernel
def carry(
    covariance: Floats,
    drift_m2ps3: Floats,
    velocity_lasts_s: Floats,
    interval_s: float,
    terms: MemoryTerms,
    ordered: Flags,
    views: Floats,
    since_s: Floats,
    prior: Floats,
) -> None:
    """Predict and expect views, slot by slot; the process is that of `filter.motion.alone`.

    Every joint is by itself: with A, B and C the blocks of its covariance (position, position with
    velocity, velocity) and J the information of the views of a slot,

        A' = (A^-1 + J)^-1,   B' = A' W,   C' = C - W^T (B - B'),   W = A^-1 B

    Args:
        covariance: `(num_tracks, num_joints, 6, 6)` of the newest slot.
        drift_m2ps3: `(num_tracks, num_joints)` as in `Outlook`.
        velocity_lasts_s: as in `Outlook`.
        interval_s: seconds per slot.
        terms: how long errors last.
        ordered: `(num_ordered, num_cameras)` cameras of the next slots; the slot after them is the
            one that `prior` is for.
        views: `(num_cameras, num_tracks, num_joints, 6)` information of a view with new errors.
        since_s: `(num_tracks, num_cameras)` seconds since each camera showed the person; advanced
            to the last slot, in place.
        prior: `(num_tracks, num_joints, 6)` filled with the information before that slot.
    """
    num_ordered, num_cameras = ordered.shape
    shares = np.zeros((num_ordered, num_cameras))
    A, B, C, information = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(6)
    room = np.empty((3, 3, 3))
    for track in range(covariance.shape[0]):
        for slot in range(num_ordered + 1):
            for camera in range(num_cameras):
                since_s[track, camera] += interval_s
                if slot < num_ordered and ordered[slot, camera]:
                    shares[slot, camera] = 1.0 / inflation(since_s[track, camera], terms)
                    since_s[track, camera] = 0.0
        for joint in range(covariance.shape[1]):
            for a in range(3):
                for b in range(3):
                    A[a, b] = covariance[track, joint, a, b]
                    B[a, b] = covariance[track, joint, a, b + 3]
                    C[a, b] = covariance[track, joint, a + 3, b + 3]
            lasts_s = velocity_lasts_s[joint]
            drift = drift_m2ps3[track, joint]
            fade = math.exp(-interval_s / lasts_s)
            for slot in range(num_ordered + 1):
                _move_on(A, B, C, lasts_s, fade, drift, interval_s)
                if slot == num_ordered:
                    break
                for entry in range(6):
                    information[entry] = 0.0
                for camera in range(num_cameras):
                    if ordered[slot, camera]:
                        share = shares[slot, camera]
                        for entry in range(6):
                            information[entry] += share * views[camera, track, joint, entry]
                if information[0] + information[3] + information[5] > 0.0:
                    _expect(A, B, C, information, room)
            _invert(A, room[0])
            entry = 0
            for a in range(3):
                for b in range(a, 3):
                    prior[track, joint, entry] = room[0, a, b]
                    entry += 1


@kernel
def _move_on(
    A: Floats, B: Floats, C: Floats, lasts_s: float, fade: float, drift: float, dt: float
) -> None:
    reach = lasts_s * (1.0 - fade)
    turned = lasts_s * (1.0 - fade * fade) / 2
    for a in range(3):
        for b in range(a, 3):
            A[a, b] += reach * (B[a, b] + B[b, a]) + reach * reach * C[a, b]
            if a == b:
                A[a, b] += drift * lasts_s**2 * (dt - 2 * reach + turned)
            A[b, a] = A[a, b]
    for a in range(3):
        for b in range(3):
            own = drift if a == b else 0.0
            B[a, b] = fade * (B[a, b] + reach * C[a, b]) + own * reach**2 / 2
            C[a, b] = fade * fade * C[a, b] + own * turned


@kernel
def _expect(A: Floats, B: Floats, C: Floats, information: Floats, room: Floats) -> None:
    """Update the blocks by views with `information`."""
    inverse, total, W = room[0], room[1], room[2]
    _invert(A, inverse)
    entry = 0
    for a in range(3):
        for b in range(a, 3):
            total[a, b] = inverse[a, b] + information[entry]
            total[b, a] = total[a, b]
            entry += 1
    _multiply(inverse, B, W)
    _invert(total, A)
    _multiply(A, W, total)
    for a in range(3):
        for b in range(3):
            gone = W[0, a] * (B[0, b] - total[0, b]) + W[1, a] * (B[1, b] - total[1, b])
            C[a, b] -= gone + W[2, a] * (B[2, b] - total[2, b])
    for a in range(3):
        for b in range(3):
            B[a, b] = total[a, b]


@kernel
def _multiply(first: Floats, second: Floats, product: Floats) -> None:
    """Fill the product of two 3 x 3 matrices; the output must be neither of them."""
    for a in range(3):
        for b in range(3):
            product[a, b] = (
                first[a, 0] * second[0, b] + first[a, 1] * second[1, b] + first[a, 2] * second[2, b]
            )


@kernel
def _invert(m: Floats, inverse: Floats) -> None:
    """Fill the inverse of a symmetric 3 x 3 matrix; they may not be the same."""
    xx, xy, xz, yy, yz, zz = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    inverse[0, 0] = yy * zz - yz * yz
    inverse[0, 1] = xz * yz - xy * zz
    inverse[0, 2] = xy * yz - xz * yy
    scale = 1.0 / (xx * inverse[0, 0] + xy * inverse[0, 1] + xz * inverse[0, 2])
    inverse[1, 1] = xx * zz - xz * xz
    inverse[1, 2] = xy * xz - xx * yz
    inverse[2, 2] = xx * yy - xy * xy
    for a in range(3):
        for b in range(a, 3):
            inverse[a, b] *= scale
            inverse[b, a] = inverse[a, b]
