"""Time shift between two views: by the motion of joints, and by epipolar geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import fftconvolve

from e3pose.base.arrays import Floats
from e3pose.calibrate.essential import epipolar_errors
from e3pose.calibrate.pair_shifts import subsample_peak
from e3pose.calibrate.same_people import Seen, one_to_one, pair_by_essential, pair_by_rig
from e3pose.calibrate.tracklets import Tracklet
from e3pose.model.camera import Rig
from e3pose.recording.record import Recording

STEP = 0.125  # of a slot, in the search by geometry
REACH = 1.5  # slots to either side of the coarse shift
MOST_SIGMAS = 3.0  # errors count at most this much
MIN_JOINTS = 200  # to compare two views by geometry
MOST_TRACKLETS = 12  # of a view, by motion
MOST_SPEED = 0.3  # body sizes per slot; more is a mistake of the detector
MOST_CANDIDATES = 4  # shifts by motion that geometry decides between


def motion_signals(recording: Recording, camera: int, seen: Seen) -> list[Floats]:
    """Return, by person followed in a view, how their joints move: downwards, and how fast in all.

    Each is `(num_slots, 2 * num_joints)`, in body sizes per slot and free of its mean; 0 where the
    person is not seen. The longest `MOST_TRACKLETS` are taken.
    """
    own = [i for i, t in enumerate(seen.tracklets) if t.camera == camera]
    own = sorted(own, key=lambda i: -len(seen.tracklets[i]))[:MOST_TRACKLETS]
    signals = []
    for index in own:
        tracklet, ideal = seen.tracklets[index], seen.ideal[index]
        gaps = np.diff(tracklet.slots)
        low = np.where(np.isfinite(ideal), ideal, np.inf).min(axis=1)
        high = np.where(np.isfinite(ideal), ideal, -np.inf).max(axis=1)
        size = float(np.median((high - low)[:, 1]))
        if not 0 < size < np.inf:
            continue
        speed = np.diff(ideal, axis=0) / (size * gaps[:, None, None])
        moved = np.concatenate([speed[..., 1], np.linalg.norm(speed, axis=-1)], axis=-1)
        moved[gaps > 2] = np.nan
        good = np.isfinite(moved) & (np.abs(moved) < MOST_SPEED)
        mean = np.where(good, moved, 0.0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
        signal = np.zeros((recording.num_slots, moved.shape[1]))
        signal[tracklet.slots[:-1]] = np.where(good, moved - mean, 0.0)
        signals.append(signal)
    return signals


def shift_by_motion(
    first: Sequence[Floats], second: Sequence[Floats], most: int
) -> tuple[list[float], float]:
    """Return the likeliest shifts in slots, best first, and how far the best stands out.

    Args:
        first: signals `(num_slots, num_signals)` of the people of one camera.
        second: likewise of the other; `second[t]` belongs to `first[t + shift]`.
        most: largest shift.

    Returns:
        Up to `MOST_CANDIDATES` shifts, and the best's height above the median of all shifts, in
        standard deviations; none and 0 without people.
    """
    if not first or not second:
        return [], 0.0
    most = min(most, len(first[0]) - 2)
    # Each person of one view is one of the other view's at most: the best counts.
    scores = sum(
        np.max([_correlation(one, other, most) for other in second], axis=0) for one in first
    )
    scores = np.asarray(scores)
    middle = float(np.median(scores))
    spread = 1.4826 * float(np.median(np.abs(scores - middle))) + 1e-12
    peaks = np.flatnonzero(
        (scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1)) & (scores > middle)
    )
    best = peaks[np.argsort(-scores[peaks])][:MOST_CANDIDATES]
    if not len(best):
        return [], 0.0
    shifts = [float(i - most + subsample_peak(scores, int(i))) for i in best]
    return shifts, float((scores[best[0]] - middle) / spread)


def _correlation(first: Floats, second: Floats, most: int) -> Floats:
    """Return `(2 * most + 1,)` correlations, times the root of the energy that overlaps."""
    products = fftconvolve(first, second[::-1], axes=0).sum(axis=1)
    energy_first = fftconvolve(first**2, (second[::-1] != 0).astype(float), axes=0).sum(axis=1)
    energy_second = fftconvolve((first != 0).astype(float), second[::-1] ** 2, axes=0).sum(axis=1)
    middle = len(first) - 1
    window = slice(middle - most, middle + most + 1)
    below = np.sqrt(np.maximum(energy_first * energy_second, 0.0))[window]
    # Signals that hardly overlap may agree by chance.
    floor = 0.2 * float(below.max(initial=0.0)) + 1e-12
    score = products[window] / np.maximum(below, floor)
    return np.asarray(score * np.sqrt(np.minimum(below / floor, 5.0)))


def shift_by_geometry(
    rig: Rig, seen: Seen, a: int, b: int, coarse: float
) -> tuple[float, float] | None:
    """Return the cost and the shift in slots at which joints lie on epipolar lines best.

    None if too few joints can be compared. The cost is the mean of bounded squares, 1 to 2 where
    the noise alone is left.

    Args:
        rig: whose extrinsics count where it is placed.
        seen: tracklets of all views.
        a: index of a camera.
        b: index of another.
        coarse: shift of b's slots to a's, within about a slot.
    """
    centre, least = coarse, np.inf
    for _ in range(2):  # the essential matrix of the second round has the better shift
        whole = round(centre)
        moved = _moved(seen, b, whole)
        found = _relative(rig, moved, a, b)
        if found is None:
            return None
        R, t, pairs = found
        fractions = np.arange(-REACH, REACH + STEP / 2, STEP)
        costs = np.array([_cost(moved, pairs, R, t, f) for f in fractions])
        if not np.isfinite(costs).all():
            return None
        best = int(np.argmin(costs))
        least = float(costs[best])
        if best in (0, len(costs) - 1):
            centre = whole + float(fractions[best])
            continue
        centre = whole + float(fractions[best]) + STEP * subsample_peak(-costs, best)
    return least, centre


def _moved(seen: Seen, camera: int, slots: int) -> Seen:
    tracklets = [
        Tracklet(t.camera, t.slots + slots, t.rows) if t.camera == camera else t
        for t in seen.tracklets
    ]
    return Seen(tracklets, seen.ideal, seen.sigma)


def _relative(
    rig: Rig, seen: Seen, a: int, b: int
) -> tuple[Floats, Floats, list[tuple[int, int]]] | None:
    if rig.placed:
        first, second = rig.cameras[a], rig.cameras[b]
        R = second.R @ first.R.T
        t = second.t - R @ first.t
        t = t / max(float(np.linalg.norm(t)), 1e-9)
        pairs = one_to_one(pair_by_rig(seen, a, b, R, t, 8.0))
        return (R, t, pairs) if pairs else None
    found = pair_by_essential(seen, a, b)
    return None if found is None else (found[0].R, found[0].t, one_to_one(found[1]))


def _cost(seen: Seen, pairs: list[tuple[int, int]], R: Floats, t: Floats, fraction: float) -> float:
    """Return the mean of bounded squared epipolar errors when the second view is shifted."""
    total, count = 0.0, 0
    for a, b in pairs:
        first, second = seen.tracklets[a], seen.tracklets[b]
        wanted = first.slots - fraction  # where in the second view's slots
        below = np.searchsorted(second.slots, wanted, side="right") - 1
        good = (below >= 0) & (below + 1 < len(second.slots))
        i, j = np.flatnonzero(good), below[good]
        gap = second.slots[j + 1] - second.slots[j]
        i, j, gap = i[gap <= 2], j[gap <= 2], gap[gap <= 2]
        share = ((wanted[i] - second.slots[j]) / gap)[:, None, None]
        q = (1 - share) * seen.ideal[b][j] + share * seen.ideal[b][j + 1]
        p = seen.ideal[a][i]
        sigma = np.hypot(seen.sigma[a][i], seen.sigma[b][j])
        known = np.isfinite(p[..., 0]) & np.isfinite(q[..., 0])
        errors = epipolar_errors(R, t, p[known], q[known]) / sigma[known]
        total += float(np.minimum(errors, MOST_SIGMAS) @ np.minimum(errors, MOST_SIGMAS))
        count += int(known.sum())
    return total / count if count >= MIN_JOINTS else np.inf
