"""Which tracklets of different views are one person: by essential matrices, or by a known rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.calibrate.essential import RelativePose, epipolar_errors, relative_pose
from e3pose.calibrate.tracklets import Tracklet

Floats = NDArray[np.float64]

MIN_COMMON = 60  # joints that two tracklets share before they are compared
MOST_COMMON = 400
MOST_HYPOTHESES = 24  # tracklet pairs, of one pair of cameras, that may propose its pose
SAME_SHARE = 0.55  # of joints near the epipolar lines, from which two tracklets may be one person
TOLERANCE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """All tracklets of a recording with their joints.

    Attributes:
        tracklets: of all views.
        ideal: by tracklet, `(n, num_joints, 2)` normalised points; NaN where missing.
        sigma: by tracklet, `(n, num_joints)` standard deviations in normalised units.
    """

    tracklets: Sequence[Tracklet]
    ideal: Sequence[Floats]
    sigma: Sequence[Floats]

    def common(self, a: int, b: int) -> tuple[Floats, Floats, Floats] | None:
        """Return the joints that two tracklets show at the same time, and their deviations."""
        first, second = self.tracklets[a], self.tracklets[b]
        _, i, j = np.intersect1d(first.slots, second.slots, True, return_indices=True)
        if len(i) == 0:
            return None
        p, q = self.ideal[a][i].reshape(-1, 2), self.ideal[b][j].reshape(-1, 2)
        sigma = np.hypot(self.sigma[a][i], self.sigma[b][j]).reshape(-1)
        both = np.flatnonzero(np.isfinite(p[:, 0]) & np.isfinite(q[:, 0]))
        if len(both) < MIN_COMMON:
            return None
        if len(both) > MOST_COMMON:
            both = both[np.linspace(0, len(both) - 1, MOST_COMMON).astype(int)]
        return p[both], q[both], sigma[both]


Pairing = dict[tuple[int, int], float]  # tracklets to how well they fit, larger is better


def pair_by_essential(seen: Seen, first: int, second: int) -> tuple[RelativePose, Pairing] | None:
    """Find the relative pose of two cameras that lets most people be seen by both.

    Each promising pair of tracklets proposes a pose; all people of both views judge it.

    Args:
        seen: the tracklets.
        first: index of a camera.
        second: index of another.
    """
    common = _all_common(seen, first, second)
    if not common:
        return None
    promising = sorted(common, key=lambda pair: -_motion(*common[pair]))[:MOST_HYPOTHESES]
    best: tuple[float, RelativePose, Pairing] | None = None
    for pair in promising:
        p, q, sigma = common[pair]
        pose = relative_pose(p, q, TOLERANCE_SIGMAS * float(np.median(sigma)))
        for _ in range(2):  # once more with everybody who agrees
            if pose is None:
                break
            pairing = _pairing(common, pose.R, pose.t, TOLERANCE_SIGMAS)
            total = sum(len(common[k][0]) * (share - 0.4) for k, share in pairing.items())
            if best is None or total > best[0]:
                best = (total, pose, pairing)
            if not pairing:
                break
            p, q, sigma = (np.concatenate([common[k][i] for k in pairing]) for i in range(3))
            pose = relative_pose(p, q, TOLERANCE_SIGMAS * float(np.median(sigma)))
    if best is None or not best[2]:
        return None
    return best[1], best[2]


def pair_by_rig(
    seen: Seen, first: int, second: int, R: Floats, t: Floats, tolerance_sigmas: float
) -> Pairing:
    """Pair the tracklets of two cameras whose relative pose is known.

    Args:
        seen: the tracklets.
        first: index of a camera.
        second: index of another.
        R: `(3, 3)` first camera to second.
        t: `(3,)` likewise.
        tolerance_sigmas: distance to the epipolar line up to which a joint agrees.
    """
    return _pairing(_all_common(seen, first, second), R, t, tolerance_sigmas)


def group(seen: Seen, pairings: Sequence[Pairing]) -> list[list[int]]:
    """Join paired tracklets into people: best pairs first, never two of a view at one time."""
    owner = list(range(len(seen.tracklets)))
    members = {i: [i] for i in owner}
    links = [(share, pair) for pairing in pairings for pair, share in pairing.items()]
    for _, (a, b) in sorted(links, key=lambda link: -link[0]):
        one, other = owner[a], owner[b]
        if one == other or _clash(seen, members[one], members[other]):
            continue
        for tracklet in members.pop(other):
            owner[tracklet] = one
            members[one].append(tracklet)
    return [sorted(people) for people in members.values() if len(people) > 1]


def _clash(seen: Seen, one: list[int], other: list[int]) -> bool:
    for a in one:
        for b in other:
            first, second = seen.tracklets[a], seen.tracklets[b]
            if first.camera == second.camera and len(np.intersect1d(first.slots, second.slots)):
                return True
    return False


def _all_common(
    seen: Seen, first: int, second: int
) -> dict[tuple[int, int], tuple[Floats, Floats, Floats]]:
    ours = [i for i, t in enumerate(seen.tracklets) if t.camera == first]
    theirs = [i for i, t in enumerate(seen.tracklets) if t.camera == second]
    found = {}
    for a in ours:
        for b in theirs:
            common = seen.common(a, b)
            if common is not None:
                found[a, b] = common
    return found


def _motion(p: Floats, q: Floats, sigma: Floats) -> float:
    """Somebody who walks about fixes a pose better than somebody who stands."""
    return float(np.sqrt(len(sigma)) * np.sqrt(p.std(axis=0).prod() * q.std(axis=0).prod()))


def _pairing(
    common: dict[tuple[int, int], tuple[Floats, Floats, Floats]],
    R: Floats,
    t: Floats,
    tolerance_sigmas: float,
) -> Pairing:
    """Give each tracklet its best partners, one at a time each."""
    if not common:
        return {}
    rows = sorted({a for a, _ in common})
    columns = sorted({b for _, b in common})
    share = np.zeros((len(rows), len(columns)))
    gain = np.zeros_like(share)
    for (a, b), (p, q, sigma) in common.items():
        near = epipolar_errors(R, t, p, q) <= tolerance_sigmas * sigma
        place = rows.index(a), columns.index(b)
        share[place] = near.mean()
        gain[place] = len(p) * max(0.0, near.mean() - SAME_SHARE)
    paired = {}
    # A long tracklet may pair with several short ones: rounds of one-to-one pairs, as `group` asks.
    for _ in range(3):
        for i, j in zip(*linear_sum_assignment(-gain), strict=True):
            if gain[i, j] > 0:
                paired[rows[i], columns[j]] = float(share[i, j])
                gain[i, j] = 0.0
    return paired
