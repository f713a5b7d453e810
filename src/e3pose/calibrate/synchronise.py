"""Synchronise the films of a rig by the motion of the people in them.

First by motion: how fast joints move, up and down and in all, is alike in every view, so that
signals correlate best at the right shift. Then by geometry: at the right shift, joints lie on the
epipolar lines of the same joints in the other view, whose positions are interpolated between
frames. The epipolar geometry is that of the calibration, or else the pair's own essential matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.from_people import solve_people
from e3pose.calibrate.matched_people import observe_people
from e3pose.calibrate.pair_shifts import disagreement, incidence, spanning_tree_offsets
from e3pose.calibrate.progress import Progress, silent
from e3pose.calibrate.same_people import Seen
from e3pose.calibrate.time_shift import motion_signals, shift_by_geometry, shift_by_motion
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.recording.record import Recording, ViewSeries

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
    offsets_s = found.offsets_s - _beside_slots(recording)
    return replace(found, offsets_s=offsets_s - offsets_s[0])


def _beside_slots(recording: Recording) -> Floats:
    """Return how long after the middles of its slots each camera usually takes its frames."""
    return np.array([
        np.median(series.times_s - series.slots / recording.fps) if len(series.slots) else 0.0
        for series in recording.views
    ])  # fmt: skip


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
        views.append(
            ViewSeries(
                slots[keep],
                times[keep],
                np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
                series.keypoints_px[every],
                series.scores[every],
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
