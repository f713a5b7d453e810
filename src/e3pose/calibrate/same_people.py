"""Match tracklets across views: by essential matrices, or by a known rig."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.calibrate.essential import RelativePose, epipolar_errors, relative_pose
from e3pose.calibrate.tracklets import Tracklet

MIN_COMMON = 60  # joints that two tracklets share before they are compared
MOST_COMMON = 400
MOST_HYPOTHESES = 24  # tracklet pairs, of one pair of cameras, that may propose its pose
TOLERANCE_SIGMAS = 3.0
TOLERANCE_PER_MEDIAN = 4.5  # three standard deviations, from the median of what is normal


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

    def share_of_size(self) -> float:
        """Return the median deviation of a joint, as a share of its person's size; NaN of none."""
        each = [shares_of_size(p, s) for p, s in zip(self.ideal, self.sigma, strict=True)]
        shares = np.concatenate(each) if each else np.empty(0)
        return float(np.median(shares)) if len(shares) else float("nan")


def shares_of_size(points: Floats, sigma: Floats) -> Floats:
    """Return `(n,)` the deviations of the joints that are seen, over the size of their person.

    Args:
        points: `(*batch, num_joints, 2)` of people; NaN where not seen. A person's size is the
            longer side of the box of them.
        sigma: `(*batch, num_joints)` standard deviations, in the same unit.
    """
    seen = np.isfinite(points)
    high = np.where(seen, points, -np.inf).max(axis=-2, initial=-np.inf)
    low = np.where(seen, points, np.inf).min(axis=-2, initial=np.inf)
    size = (high - low).max(axis=-1)
    good = seen[..., 0] & (size > 0)[..., None]
    return np.asarray((sigma / np.where(size > 0, size, 1.0)[..., None])[good])


Evidence = dict[tuple[int, int], float]
"""Pairs of tracklets that show joints together, to how far those say one person: below 0 is two.

Of `n` joints, the sum of `1 - min((e / tolerance)^2, 2)` over their epipolar distances `e`. It is
graded, as under a wide tolerance two people are both within it: the nearer must count for more.
"""


def pair_by_essential(seen: Seen, first: int, second: int) -> tuple[RelativePose, Evidence] | None:
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
    best: tuple[float, RelativePose, Evidence] | None = None
    for pair in promising:
        p, q, sigma = common[pair]
        pose = relative_pose(p, q, TOLERANCE_SIGMAS * float(np.median(sigma)))
        for _ in range(2):  # once more with everybody who agrees
            if pose is None:
                break
            evidence = _evidence(common, pose.R, pose.t, TOLERANCE_SIGMAS)
            pairs = one_to_one(evidence)
            total = sum(evidence[k] for k in pairs)
            if pairs and (best is None or total > best[0]):
                best = (total, pose, evidence)
            if not pairs:
                break
            p, q, sigma = (np.concatenate([common[k][i] for k in pairs]) for i in range(3))
            pose = relative_pose(p, q, TOLERANCE_SIGMAS * float(np.median(sigma)))
    return None if best is None else best[1:]


def pair_by_rig(
    seen: Seen,
    first: int,
    second: int,
    R: Floats,
    t: Floats,
    tolerance_sigmas: float,
    least_sigmas: float | None = None,
) -> Evidence:
    """Compare the tracklets of two cameras whose relative pose is known.

    Args:
        seen: the tracklets.
        first: index of a camera.
        second: index of another.
        R: `(3, 3)` first camera to second.
        t: `(3,)` likewise.
        tolerance_sigmas: distance to the epipolar line up to which a joint agrees.
        least_sigmas: where given, the tolerance is narrowed towards this as far as the people who
            fit best allow: a wide one is for cameras that are off, and lets two people pass for
            one elsewhere.
    """
    common = _all_common(seen, first, second)
    if least_sigmas is not None:
        nearest = TOLERANCE_PER_MEDIAN * _nearest_sigmas(common, R, t)
        tolerance_sigmas = min(tolerance_sigmas, max(nearest, least_sigmas))
    return _evidence(common, R, t, tolerance_sigmas)


def one_to_one(evidence: Evidence) -> list[tuple[int, int]]:
    """Return the pairs of two cameras' tracklets that are one person: best match first."""
    rows = sorted({a for a, _ in evidence})
    columns = sorted({b for _, b in evidence})
    gain = np.zeros((len(rows), len(columns)))
    for (a, b), value in evidence.items():
        gain[rows.index(a), columns.index(b)] = max(value, 0.0)
    pairs = []
    # A long tracklet may pair with several short ones: rounds of one-to-one pairs, as `group` asks.
    for _ in range(3):
        for i, j in zip(*linear_sum_assignment(-gain), strict=True):
            if gain[i, j] > 0:
                pairs.append((rows[i], columns[j]))
                gain[i, j] = 0.0
    return pairs


def group(seen: Seen, evidences: Sequence[Evidence]) -> list[list[int]]:
    """Join tracklets into people, never two of a view at one time.

    Those that most evidence joins come first; all pairs of two groups count, those that speak
    against it too, so that one pair that agrees by chance joins nobody.

    Args:
        seen: the tracklets.
        evidences: of pairs of cameras.
    """
    members = {i: [i] for i in range(len(seen.tracklets))}
    between: dict[int, dict[int, float]] = {i: {} for i in members}
    waiting: list[tuple[float, int, int]] = []
    for evidence in evidences:
        for (a, b), value in evidence.items():
            between[a][b] = between[b][a] = value
            waiting.append((-value, a, b))
    heapq.heapify(waiting)
    while waiting and waiting[0][0] < 0:
        value, a, b = heapq.heappop(waiting)
        if a not in members or b not in members or between[a].get(b) != -value:
            continue  # one was joined to others meanwhile
        if _clash(seen, members[a], members[b]):
            del between[a][b], between[b][a]
            continue
        members[a] += members.pop(b)
        for other, more in between.pop(b).items():
            del between[other][b]
            if other != a:
                total = between[a].get(other, 0.0) + more
                between[a][other] = between[other][a] = total
                heapq.heappush(waiting, (-total, a, other))
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


def _nearest_sigmas(
    common: dict[tuple[int, int], tuple[Floats, Floats, Floats]], R: Floats, t: Floats
) -> float:
    """Return the median over tracklets of the first view of their best partner's median error."""
    best: dict[int, float] = {}
    for (a, _), (p, q, sigma) in common.items():
        error = float(np.median(epipolar_errors(R, t, p, q) / sigma))
        best[a] = min(best.get(a, np.inf), error)
    return float(np.median(list(best.values()))) if best else 0.0


def _evidence(
    common: dict[tuple[int, int], tuple[Floats, Floats, Floats]],
    R: Floats,
    t: Floats,
    tolerance_sigmas: float,
) -> Evidence:
    found = {}
    for pair, (p, q, sigma) in common.items():
        squares = (epipolar_errors(R, t, p, q) / (tolerance_sigmas * sigma)) ** 2
        found[pair] = float((1 - np.minimum(squares, 2.0)).sum())
    return found
