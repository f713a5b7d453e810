"""Relative pose of two cameras from common points: the five-point algorithm.

D. Nister, "An efficient solution to the five-point relative pose problem" (2004), inside RANSAC
(Fischler and Bolles 1981), as OpenCV has them; Hartley and Zisserman, "Multiple view geometry",
chapters 9 and 11. The length of the baseline stays unknown: it is 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.rotations import cross_matrices

MIN_POINTS = 12  # five fix the pose, of any points at all
MAX_POINTS = 600  # for the five-point samples; all are counted afterwards
MIN_PARALLAX = np.radians(2.0)  # rays nearer to parallel say nothing of depth
SEED = 7


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """A second camera seen from a first.

    Attributes:
        R: `(3, 3)` first camera to second.
        t: `(3,)` likewise, of length 1.
        inliers: `(num_points,)` which points agree.
        parallax: median angle between the rays of inliers, radians.
    """

    R: Floats
    t: Floats
    inliers: NDArray[np.bool_]
    parallax: float


def relative_pose(first: Floats, second: Floats, tolerance: float) -> RelativePose | None:
    """Find the relative pose that most points agree with; None if there is none.

    Args:
        first: `(num_points, 2)` ideal normalised points in the first camera.
        second: `(num_points, 2)` the same points in the second.
        tolerance: distance to the epipolar line, in normalised units, up to which a point agrees.
    """
    import cv2

    if len(first) < MIN_POINTS:
        return None
    rng = np.random.default_rng(SEED)
    sample = rng.permutation(len(first))[:MAX_POINTS]
    cv2.setRNGSeed(SEED)
    try:
        E, _ = cv2.findEssentialMat(
            first[sample], second[sample], np.eye(3), method=cv2.RANSAC, prob=0.9999,
            threshold=tolerance, maxIters=2000,
        )  # fmt: skip
    except cv2.error:
        return None
    if E is None or len(E) < 3:
        return None
    best: RelativePose | None = None
    for number in range(len(E) // 3):
        found = _decompose(E[3 * number : 3 * number + 3], first, second, tolerance)
        if found and (best is None or found.inliers.sum() > best.inliers.sum()):
            best = found
    return best


def epipolar_errors(R: Floats, t: Floats, first: Floats, second: Floats) -> Floats:
    """Return Sampson's distances `(num_points,)` in normalised units (Hartley-Zisserman 11.4.3).

    Args:
        R: `(3, 3)` first camera to second.
        t: `(3,)` likewise.
        first: `(num_points, 2)` ideal points in the first camera.
        second: `(num_points, 2)` in the second.
    """
    E = cross_matrices(t) @ R
    a = np.column_stack([first, np.ones(len(first))])
    b = np.column_stack([second, np.ones(len(second))])
    line_b, line_a = a @ E.T, b @ E
    error = (b * line_b).sum(axis=1)
    slope = (line_b[:, :2] ** 2).sum(axis=1) + (line_a[:, :2] ** 2).sum(axis=1)
    return np.asarray(np.abs(error) / np.sqrt(np.maximum(slope, 1e-18)))


def _decompose(E: Floats, first: Floats, second: Floats, tolerance: float) -> RelativePose | None:
    """Take, of the four poses of an essential matrix, the one with most points before both."""
    left, _, right = np.linalg.svd(E)
    left *= np.sign(np.linalg.det(left))
    right *= np.sign(np.linalg.det(right))
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    best, most = None, 0
    for R in (left @ W @ right, left @ W.T @ right):
        for t in (left[:, 2], -left[:, 2]):
            near = epipolar_errors(R, t, first, second) <= tolerance
            depth_first, depth_second, angle = _depths(R, t, first, second)
            good = near & (depth_first > 0) & (depth_second > 0)
            if good.sum() > most:
                most = int(good.sum())
                best = RelativePose(R, t, good, float(np.median(angle[good])))
    if best is None or most < MIN_POINTS or best.parallax < MIN_PARALLAX:
        return None
    return best


def _depths(R: Floats, t: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Return depths along both rays where they pass nearest to each other, and their angle."""
    a = np.column_stack([first, np.ones(len(first))]) @ R.T
    b = np.column_stack([second, np.ones(len(second))])
    # s b - r a = t in the second camera's frame
    aa, bb, ab = (a * a).sum(axis=1), (b * b).sum(axis=1), (a * b).sum(axis=1)
    at, bt = a @ t, b @ t
    below = np.maximum(aa * bb - ab**2, 1e-12)
    angle = np.arccos(np.clip(ab / np.sqrt(aa * bb), -1, 1))
    return (ab * bt - bb * at) / below, (aa * bt - ab * at) / below, angle
