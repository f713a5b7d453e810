"""Find by how much films are shifted in time, from the sound that all of them heard.

What is compared is when sounds begin: the rise of the loudness in a few bands, a thousand times a
second. It is alike in microphones that differ in distance, phase and echo, and stays so when their
clocks drift by a few milliseconds; the waves themselves do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, fftconvolve, sosfilt

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.pair_shifts import (
    disagreement,
    incidence,
    spanning_tree_offsets,
    subsample_peak,
)

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
