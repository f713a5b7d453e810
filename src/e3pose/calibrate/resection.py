"""Place one camera by people whom other cameras place, without knowing who is who in its view.

Each promising pair of a tracklet and a placed person proposes a position by PnP with RANSAC
(Fischler and Bolles 1981); all people judge it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.calibrate import same_people
from e3pose.calibrate.same_people import MIN_COMMON, MOST_COMMON, Evidence, Seen, one_to_one

Pairs = dict[tuple[int, int], tuple[Floats, Floats, Floats]]

MOST_HYPOTHESES = 12  # capacity: pairs of tracklet and person that may propose a position
SEED = 7  # definition: any number, always the same


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPerson:
    """A person whom other cameras place.

    Attributes:
        slots: `(n,)` rising.
        joints: `(n, num_joints, 3)` NaN where not placed.
    """

    slots: NDArray[np.int64]
    joints: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Resected:
    """A camera placed by people.

    Attributes:
        R: `(3, 3)` world to camera.
        t: `(3,)` likewise.
        evidence: sum over joints of `1 - min((e / tolerance)^2, 2)`.
    """

    R: Floats
    t: Floats
    evidence: float


def resect(seen: Seen, camera: int, people: Sequence[PlacedPerson]) -> Resected | None:
    """Find where a camera explains most of the people whom others place; None if nowhere.

    Args:
        seen: the tracklets, of which those of `camera` are used.
        camera: its index.
        people: where the others place them.
    """
    import cv2

    common = _common(seen, camera, people)
    best: Resected | None = None
    promising = sorted(common, key=lambda pair: -_spread(*common[pair]))[:MOST_HYPOTHESES]
    cv2.setRNGSeed(SEED)
    for pair in promising:
        ideal, points, sigma = common[pair]
        for _ in range(2):  # once more with everybody who agrees
            found, turn, shift, inliers = cv2.solvePnPRansac(
                points, ideal, np.eye(3), None, iterationsCount=300, confidence=0.999,
                reprojectionError=same_people.TOLERANCE_SIGMAS * float(np.median(sigma)),
                flags=cv2.SOLVEPNP_SQPNP,
            )  # fmt: skip
            if not found or inliers is None:
                break
            trial = _judged(common, np.asarray(cv2.Rodrigues(turn)[0]), np.asarray(shift[:, 0]))
            if trial.evidence > (0.0 if best is None else best.evidence):
                best = trial
            pairs = one_to_one(_evidence(common, trial.R, trial.t))
            if not pairs:
                break
            ideal, points, sigma = (np.concatenate([common[k][i] for k in pairs]) for i in range(3))
    return best


def _common(seen: Seen, camera: int, people: Sequence[PlacedPerson]) -> Pairs:
    """Return ideal points, places and deviations of the joints that tracklets and people share."""
    found = {}
    for index, tracklet in enumerate(seen.tracklets):
        if tracklet.camera != camera:
            continue
        for number, person in enumerate(people):
            _, i, j = np.intersect1d(tracklet.slots, person.slots, True, return_indices=True)
            ideal = seen.ideal[index][i].reshape(-1, 2)
            points = person.joints[j].reshape(-1, 3)
            both = np.flatnonzero(np.isfinite(ideal[:, 0]) & np.isfinite(points[:, 0]))
            if len(both) < MIN_COMMON:
                continue
            if len(both) > MOST_COMMON:
                both = both[np.linspace(0, len(both) - 1, MOST_COMMON).astype(int)]
            found[index, number] = (ideal[both], points[both], seen.sigma[index][i].ravel()[both])
    return found


def _spread(ideal: Floats, points: Floats, sigma: Floats) -> float:
    del sigma
    return float(np.sqrt(len(points)) * ideal.std(axis=0).prod() * points.std(axis=0).prod())


def _judged(common: Pairs, R: Floats, t: Floats) -> Resected:
    evidence = _evidence(common, R, t)
    return Resected(R, t, sum(evidence[pair] for pair in one_to_one(evidence)))


def _evidence(common: Pairs, R: Floats, t: Floats) -> Evidence:
    found = {}
    for pair, (ideal, points, sigma) in common.items():
        inside = points @ R.T + t
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.linalg.norm(inside[:, :2] / inside[:, 2:] - ideal, axis=-1)
        off /= same_people.TOLERANCE_SIGMAS * sigma
        squares = np.where(inside[:, 2] > 0, off**2, np.inf)
        found[pair] = float((1 - np.minimum(squares, 2.0)).sum())
    return found
