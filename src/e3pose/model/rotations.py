"""Rotations: angles between them, the nearest to a matrix, similarity of point sets."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats


def cross_matrices(vectors: Floats) -> Floats:
    """Return `(*batch, 3, 3)` matrices that multiply as the cross product with `(*batch, 3)`."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_of(vector: Floats) -> Floats:
    """Return the rotation `(3, 3)` of a Rodrigues vector `(3,)`: its axis times its angle.

    Rodrigues' formula. SciPy has it too, but takes longer to import than all that reads a rig.
    """
    angle = float(np.linalg.norm(vector))
    cross = cross_matrices(vector)
    # np.sinc(x) is sin(pi x) / (pi x), which is 1 for no rotation
    turn, tilt = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.asarray(np.eye(3) + turn * cross + tilt * cross @ cross)


def angles_between(first: Floats, second: Floats) -> Floats:
    """Return the angles in radians between two stacks of rotations, `(n, 3, 3)` each."""
    from scipy.spatial.transform import Rotation  # slow to import

    return np.asarray(
        Rotation.from_matrix(np.einsum("nij,nkj->nik", first, second)).magnitude(),
        dtype=np.float64,
    )


def similarity(
    source: Floats, target: Floats, with_scale: bool = True
) -> tuple[float, Floats, Floats]:
    """Return scale, rotation and shift that bring points onto points with the least squares.

    `target = scale * rotation @ source + shift` (Umeyama 1991, eqs. 40 to 42).

    Args:
        source: `(n, 3)` points, at least three that are not on a line.
        target: `(n, 3)` the same points elsewhere.
        with_scale: whether the scale may differ from 1.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    centred = source - source_mean
    covariance = (target - target_mean).T @ centred / len(source)
    left, singular, right = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = (left * signs) @ right
    variance = float((centred**2).sum() / len(source))
    scale = float((singular * signs).sum() / variance) if with_scale and variance > 0 else 1.0
    return scale, rotation, target_mean - scale * rotation @ source_mean


def nearest_rotation(matrices: Floats) -> Floats:
    """Return the rotations `(*batch, 3, 3)` nearest to matrices by the Frobenius norm.

    Of a correlation of vectors `sum(target source^T)` it is the rotation that brings the source
    onto the target with the least squares (Kabsch 1976).
    """
    left, _, right = np.linalg.svd(matrices)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right, dtype=np.float64)
