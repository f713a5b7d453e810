"""Synchronise the films of a rig by the motion of the people in them.

First by motion: how fast joints move, up and down and in all, is alike in every view, so that
signals correlate best at the right shift. Then by geometry: at the right shift, joints lie on the
epipolar lines of the same joints in the other view, whose positions are interpolated between
frames. The epipolar geometry is that of the calibration, or else the pair's own essential matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, fftconvolve, sosfilt

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.essential import epipolar_errors
from e3pose.calibrate.from_people import Progress, silent, solve_people
from e3pose.calibrate.matched_people import observe_people
from e3pose.calibrate.same_people import Seen, one_to_one, pair_by_essential, pair_by_rig
from e3pose.calibrate.tracklets import Tracklet
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.recording.record import Recording, ViewSeries


def subsample_peak(values: Floats, best: int) -> float:
    """Return where a parabola through the greatest value and its neighbours has its peak.

    Args:
        values: `(num_values,)`, such as correlations by shift.
        best: index of the greatest.

    Returns:
        Steps from `best`, within half a step; 0 at either end.
    """
    if not 0 < best < len(values) - 1:
        return 0.0
    before, middle, after = values[best - 1 : best + 2]
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def spanning_tree_offsets(num_cameras: int, pairs: Sequence[tuple[int, int, float]]) -> Floats:
    """Return each camera's offset against the first, along a maximum spanning tree (Prim).

    Args:
        num_cameras: how many.
        pairs: two cameras, and the second's offset minus the first's; most certain pair first.

    Returns:
        `(num_cameras,)` in the unit of the shifts; NaN where no pair leads to the first camera.
    """
    offsets = np.full(num_cameras, np.nan)
    offsets[0] = 0.0

    def reaches(pair: tuple[int, int, float]) -> bool:
        return bool(np.isnan(offsets[pair[0]]) != np.isnan(offsets[pair[1]]))

    while (pair := next(filter(reaches, pairs), None)) is not None:
        a, b, shift = pair
        if np.isnan(offsets[b]):
            offsets[b] = offsets[a] + shift
        else:
            offsets[a] = offsets[b] - shift
    return offsets


def incidence(num_cameras: int, pairs: Sequence[tuple[int, int, float]]) -> Floats:
    """Return `(num_pairs, num_cameras)`: by which offsets are multiplied to give the shifts."""
    rows = np.zeros((len(pairs), num_cameras))
    for row, (a, b, _) in zip(rows, pairs, strict=True):
        row[a], row[b] = -1.0, 1.0
    return rows


def disagreement(rows: Floats, misses: Floats, weights: Floats) -> Floats:
    """Return `(num_cameras,)` rms residuals of each camera's pairs; NaN for a single pair.

    Args:
        rows: of `incidence`.
        misses: `(num_pairs,)` the offsets' shift minus the pair's.
        weights: `(num_pairs,)` of the pairs.
    """
    rms = np.full(rows.shape[1], np.nan)
    for camera, column in enumerate(rows.T):
        own = np.flatnonzero(column)
        if len(own) > 1:
            rms[camera] = np.sqrt(np.average(misses[own] ** 2, weights=weights[own]))
    return rms


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


CLEAR_HEIGHT = 8.0  # standard deviations from which motion alone is believed
ENOUGH_PAIRS = 3  # of a camera, after which only cameras with fewer are looked at
SURE_COST = 2.2  # of geometry, at which other shifts are not tried
MOST_COST = 4.0  # of geometry: right shifts cost 0.4 to 2, wrong ones 1.7 and more
COARSE_SIGMA, FINE_SIGMA = 1.0, 0.05  # slots, to weigh pairs by


@dataclass(frozen=True, slots=True)
class PairShift:
    """The shift between two cameras.

    Attributes:
        first: camera index.
        second: camera index.
        slots: seconds of the second camera's clock plus this many slots are those of the first.
        height: by how many standard deviations the motion's correlation stands out.
        by_geometry: whether epipolar geometry gave the fraction.
        cost: of that geometry, 1 to 2 where the noise alone is left; infinite without.
    """

    first: int
    second: int
    slots: float
    height: float
    by_geometry: bool
    cost: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Synchrony:
    """When the films of a recording began.

    Attributes:
        offsets_s: `(num_cameras,)` when each camera's first frame was taken, against the first
            camera's.
        sure_s: `(num_cameras,)` by how much the pairs of a camera disagree with its offset, root
            mean square; NaN where one pair says all.
        pairs: what they are from.
    """

    offsets_s: Floats
    sure_s: Floats
    pairs: tuple[PairShift, ...]

    @property
    def delays_ms(self) -> Floats:
        """By how much each camera's times are late, `(num_cameras,)`; 0 of the one that is least.

        A live camera that reports frames late seems to have begun earlier than it did.
        """
        return np.asarray(1e3 * (self.offsets_s.max() - self.offsets_s))


def synchronise(
    recording: Recording,
    noise: Noise,
    max_shift_s: float,
    progress: Progress = silent,
) -> Synchrony:
    """Find the offsets of a recording's cameras.

    Without a calibration, one is solved from the people as soon as whole slots are right, and the
    fractions are found with it: the geometry of a single pair is weaker than that of a rig.

    Args:
        recording: detections; its rig helps where it is placed.
        noise: what scores promise.
        max_shift_s: films began at most so far apart.
        progress: takes a stage, its steps done and steps in all.

    Raises:
        InputError: naming the cameras whose motion fits no other's.
    """
    found = _in_slots(recording, noise, max_shift_s, progress)
    beside_slots_s = np.array([  # how long after the middles frames are usually taken
        np.median(series.times_s - series.slots / recording.fps) if len(series.slots) else 0.0
        for series in recording.views
    ])  # fmt: skip
    offsets_s = found.offsets_s - beside_slots_s
    return replace(found, offsets_s=offsets_s - offsets_s[0])


def _in_slots(
    recording: Recording,
    noise: Noise,
    max_shift_s: float,
    progress: Progress,
) -> Synchrony:
    """Find the offsets of the slots that views stand in, whatever their times."""
    first = _synchronise(recording, noise, max_shift_s, progress)
    if recording.rig.placed:
        return first
    moved = with_offsets(recording, first.offsets_s)
    try:
        solved = solve_people(moved, noise, None, progress)
    except InputError:
        return first
    if not solved.explains:
        return first
    rig = Rig(solved.solved.adjusted.rig.cameras)
    try:
        second = _synchronise(replace(moved, rig=rig), noise, 2 / recording.fps, progress)
    except InputError:
        return first
    # What `with_offsets` moved is whole slots; the rest is what the second search saw.
    whole_s = np.array([
        (int(after.slots[0]) - int(before.slots[0])) / recording.fps
        for before, after in zip(recording.views, moved.views, strict=True)
    ])  # fmt: skip
    total = whole_s + second.offsets_s
    return Synchrony(total - total[0], second.sure_s, second.pairs)


def _synchronise(
    recording: Recording,
    noise: Noise,
    max_shift_s: float,
    progress: Progress,
) -> Synchrony:
    seen = observe_people(recording, noise)
    signals = [motion_signals(recording, camera, seen) for camera in range(len(recording.rig))]
    most = max(1, round(max_shift_s * recording.fps))
    coarse = {
        (a, b): shift_by_motion(signals[a], signals[b], most)
        for a, b in combinations(range(len(recording.rig)), 2)
    }
    order = sorted(coarse, key=lambda pair: -coarse[pair][1])
    shifts: list[PairShift] = []
    degree = [0] * len(recording.rig)
    for number, (a, b) in enumerate(order):
        progress("pairs of cameras", number + 1, len(order))
        if min(degree[a], degree[b]) >= ENOUGH_PAIRS:
            continue
        found = _pair_shift(recording, seen, a, b, *coarse[a, b])
        if found is not None:
            shifts.append(found)
            degree[a], degree[b] = degree[a] + 1, degree[b] + 1
    return _solve(recording, shifts)


def _pair_shift(
    recording: Recording, seen: Seen, a: int, b: int, candidates: list[float], height: float
) -> PairShift | None:
    """Let geometry decide between the shifts that motion proposes; None if neither knows."""
    best: tuple[float, float] | None = None
    for coarse in candidates[:1] if height > CLEAR_HEIGHT else candidates:
        found = shift_by_geometry(recording.rig, seen, a, b, coarse)
        if found is not None and (best is None or found < best):
            best = found
        if best is not None and best[0] < SURE_COST:
            break
    if best is not None and best[0] < MOST_COST:
        return PairShift(a, b, best[1], height, True, best[0])
    if height > CLEAR_HEIGHT:
        return PairShift(a, b, candidates[0], height, False)
    return None


def with_offsets(recording: Recording, offsets_s: Floats) -> Recording:
    """Return a recording whose views stand in the slots in which they were taken.

    Args:
        recording: as detected.
        offsets_s: `(num_cameras,)` when each camera's first frame was taken; the earliest
            becomes 0.
    """
    offsets_s = offsets_s - offsets_s.min()
    views = []
    for series, offset_s in zip(recording.views, offsets_s.tolist(), strict=True):
        times = series.times_s + offset_s
        slots = np.floor(times * recording.fps + 0.5 - 1e-6).astype(np.int64)
        keep = np.flatnonzero(np.diff(slots, prepend=-1) > 0)
        rows = [np.arange(series.starts[i], series.starts[i + 1]) for i in keep.tolist()]
        counts = [len(row) for row in rows]
        every = np.concatenate([*rows, np.zeros(0, dtype=np.int64)]).astype(np.int64)
        whole = len(every) == len(series.scores)
        poses = [p if whole else p[every] for p in (series.keypoints_px, series.scores)]
        views.append(
            ViewSeries(
                slots[keep],
                times[keep],
                np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
                *poses,
            )
        )
    last = max((int(view.slots[-1]) for view in views if len(view.slots)), default=-1)
    return replace(recording, views=tuple(views), num_slots=last + 1, truth=None, scored_slots=None)


def _solve(recording: Recording, shifts: list[PairShift]) -> Synchrony:
    """Bring the shifts of pairs to one offset a camera, by robust least squares."""
    number = len(recording.rig)
    shifts = sorted(shifts, key=lambda s: (s.cost, -s.height))
    pairs = [(s.first, s.second, s.slots) for s in shifts]
    offsets = spanning_tree_offsets(number, pairs)
    lost = [
        c for c, offset in zip(recording.rig.camera_ids, offsets, strict=True) if np.isnan(offset)
    ]
    if lost:
        raise InputError(
            f"cameras: {', '.join(lost)}: the motion of people there fits no other camera's, "
            "expected people seen by both who move (wave, step aside), and --max-shift as large "
            "as the films may be apart"
        )
    rows = incidence(number, pairs)
    wanted = np.array([shift.slots for shift in shifts])
    sigma = np.array([FINE_SIGMA * s.cost**2 if s.by_geometry else COARSE_SIGMA for s in shifts])
    error = (rows @ offsets - wanted) / sigma
    weights = 1 / (sigma * np.sqrt(1 + (error / 3) ** 2))
    for _ in range(20):
        offsets[1:] = np.linalg.lstsq(rows[:, 1:] * weights[:, None], wanted * weights)[0]
        error = (rows @ offsets - wanted) / sigma
        weights = 1 / (sigma * np.sqrt(1 + (error / 3) ** 2))
    sure = disagreement(rows, rows @ offsets - wanted, weights)
    return Synchrony(offsets / recording.fps, sure / recording.fps, tuple(shifts))


# Find by how much films are shifted in time, from the sound that all of them heard.
#
# What is compared is when sounds begin: the rise of the loudness in a few bands, a thousand times
# a second. It is alike in microphones that differ in distance, phase and echo, and stays so when
# their clocks drift by a few milliseconds; the waves themselves do not.

RATE = 8000  # samples per second
STEPS = 1000  # of loudness, a second
BANDS_HZ = ((150.0, 600.0), (600.0, 1500.0), (1500.0, 3500.0))
SMOOTH_S = 0.006  # of the loudness
FILTER_S = 0.05  # until the bands are steady
QUIET = 0.03  # of the loudest moments: below it, noise
CLEAR = 8.0  # deviations by which a shift stands out; the best of noise alone has 4.5
AHEAD = 1.6  # times the height of any other shift; films of unrelated rooms reach 1.45
BESIDE_S = 0.05  # from a shift, where it is still the same
FULL_SHARE = 0.7  # of the shorter film; less that overlaps counts for less
LOUDEST = 12.0  # times the root mean square of rises: one clap says no more than this
LEAST_S = 2.0  # of two films at the same time
AGREE_S = 0.02  # pairs that differ more than this from the others are wrong


@dataclass(frozen=True, slots=True, eq=False)
class HeardShifts:
    """When films began, by their sound.

    Attributes:
        offsets_s: `(num_films,)` when each film's first frame was taken, against the first film's.
        sure_s: `(num_films,)` by how much the pairs of a film disagree with its offset, root mean
            square; NaN where one pair says all.
    """

    offsets_s: Floats
    sure_s: Floats


def shifts_by_sound(sounds: Mapping[str, Floats], max_shift_s: float) -> HeardShifts:
    """Find when films began.

    Args:
        sounds: by film, `(num_samples,)` at `RATE`, from its first frame on.
        max_shift_s: films began at most so far apart.

    Raises:
        InputError: naming the films whose sound fits no other's.
    """
    names = list(sounds)
    rises = [onsets(sound) for sound in sounds.values()]
    found: dict[tuple[int, int], tuple[float, float]] = {}
    for a, b in combinations(range(len(names)), 2):
        shift_s, height, ahead = shift_of(rises[a], rises[b], max_shift_s)
        if height >= CLEAR and ahead >= AHEAD:
            found[a, b] = shift_s, height
    clearest = sorted(found, key=lambda pair: -found[pair][1])
    pairs = [(*pair, found[pair][0]) for pair in clearest]
    offsets_s = spanning_tree_offsets(len(names), pairs)
    lost = [name for name, offset_s in zip(names, offsets_s, strict=True) if np.isnan(offset_s)]
    if lost:
        raise InputError(
            f"videos: {', '.join(lost)}: the sound does not match that of {names[0]} at any shift, "
            "expected videos that recorded the same sounds (three claps), and --max-shift as "
            "large as their starts differ; from people: e3pose detect, then e3pose sync RECORDING"
        )
    kept = [
        pair for pair in pairs if abs(offsets_s[pair[1]] - offsets_s[pair[0]] - pair[2]) < AGREE_S
    ]
    rows = incidence(len(names), kept)
    wanted = np.array([shift_s for _, _, shift_s in kept])
    offsets_s[1:] = np.linalg.lstsq(rows[:, 1:], wanted)[0]
    sure_s = disagreement(rows, rows @ offsets_s - wanted, np.ones(len(kept)))
    return HeardShifts(offsets_s, sure_s)


def onsets(sound: Floats) -> Floats:
    """Return `(num_steps, num_bands)`: how fast the log of the loudness rises, `STEPS` a second."""
    step = RATE // STEPS
    rises = []
    for band in BANDS_HZ:
        heard = sosfilt(butter(2, band, "bandpass", fs=RATE, output="sos"), sound)
        power = (heard[: len(heard) // step * step] ** 2).reshape(-1, step).mean(axis=1)
        loud = np.sqrt(uniform_filter1d(power, max(1, round(SMOOTH_S * STEPS))))
        floor = QUIET * float(np.quantile(loud, 0.99)) + 1e-9 if len(loud) else 1.0
        rise = np.maximum(np.diff(np.log(loud + floor), append=np.nan), 0.0)
        rise[: round(FILTER_S * STEPS)] = np.nan  # the filter starting is no sound
        rise = np.minimum(rise, LOUDEST * np.sqrt(np.nanmean(rise**2)))
        rises.append(np.nan_to_num(rise - np.nanmean(rise)) if len(rise) > STEPS else 0 * rise)
    return np.stack(rises, axis=-1)


def shift_of(first: Floats, second: Floats, max_shift_s: float) -> tuple[float, float, float]:
    """Return by how many seconds the second film began after the first, and how clearly.

    Args:
        first: `(num_steps, num_bands)` onsets.
        second: likewise.
        max_shift_s: the largest shift.

    Returns:
        Seconds, how far their correlation stands out, in standard deviations, and how many times
        as far as that of any other shift; 0 if the films are too short, or silent.
    """
    if not (first.any() and second.any()):
        return 0.0, 0.0, 0.0
    whole = fftconvolve(first, second[::-1], axes=0).sum(axis=-1)
    lags = np.arange(len(whole)) - (len(second) - 1)
    overlap = np.minimum(len(first), len(second) + lags) - np.maximum(0, lags)
    fits = (np.abs(lags) <= max_shift_s * STEPS) & (overlap >= LEAST_S * STEPS)
    if fits.sum() < STEPS // 10:
        return 0.0, 0.0, 0.0
    least = FULL_SHARE * min(len(first), len(second))  # a clap may meet another in a short overlap
    scores = whole[fits] / np.sqrt(np.maximum(overlap[fits], least))
    lags = lags[fits]
    best = int(scores.argmax())
    heights = scores - np.median(scores)
    spread = 1.4826 * float(np.median(np.abs(heights))) + 1e-12
    others = heights[np.abs(lags - lags[best]) > BESIDE_S * STEPS]
    ahead = float(heights[best] / max(others.max(initial=0.0), 1e-12))
    shift_s = float(lags[best] + subsample_peak(scores, best)) / STEPS
    return shift_s, float(heights[best]) / spread, ahead
