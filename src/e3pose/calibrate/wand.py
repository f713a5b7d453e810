"""A wand of two or more markers at known distances, adjusted as a rigid body.

Points alone place cameras up to scale (`from_points`). That the markers of one time are as far
apart as they were measured gives the scale, and ties the depth of each place of the wand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import length_m
from e3pose.calibrate.align import Move
from e3pose.calibrate.bundle import Adjusted, AdjustOptions, adjust_boards
from e3pose.calibrate.from_points import MOST_POINTS, OUTLIER_SIGMAS
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig

OPTION = "--wand"
EXAMPLE = "markers and lengths such as green,red=500mm or green,blue,red=200mm,500mm"
MOST_MARKERS = 5
LENGTHS_M = (0.05, 5.0)  # of a wand, from and to
MEASURED_M = 0.001  # how well a length is measured
MIN_TIMES = 30  # at which two markers must be placed
MOST_SPREAD = 0.15  # of the length between two markers, as a share; 0.5 to 3 % is usual
MOST_UNLIKE = 0.05  # of the ratio of two lengths, as a share


@dataclass(frozen=True, slots=True, eq=False)
class Wand:
    """Markers in a row.

    Attributes:
        markers: what they are called; in films, the colours of balls.
        places_m: `(num_markers,)` rising distances from the first, whose own is 0.
    """

    markers: tuple[str, ...]
    places_m: Floats

    @classmethod
    def parse(cls, word: str) -> Wand:
        """Read `A,B=LENGTH`, or `A,B,C=LENGTH,LENGTH` with lengths from the first marker."""
        names, equals, lengths = word.partition("=")
        markers = tuple(name.strip() for name in names.split(","))
        given = lengths.split(",")
        if not equals or not all(markers) or len(given) != len(markers) - 1:
            raise InputError(OPTION, repr(word[:60]), EXAMPLE)
        if len(markers) > MOST_MARKERS:
            raise InputError(OPTION, f"{len(markers)} markers", f"at most {MOST_MARKERS}")
        twice = [name for name in markers if markers.count(name) > 1]
        if twice:
            wanted = "markers that can be distinguished"
            raise InputError(OPTION, f"{twice[0]} twice", wanted)
        try:
            places_m = np.array([0.0, *(length_m(length) for length in given)])
        except InputError as error:
            raise error.at(thing=OPTION) from None
        if not (np.diff(places_m) > 0).all():
            wanted = "distances from the first marker, each larger than the one before"
            raise InputError(OPTION, repr(lengths[:60]), wanted)
        if not LENGTHS_M[0] <= places_m[-1] <= LENGTHS_M[1]:
            wanted = f"a wand of {LENGTHS_M[0]:g} to {LENGTHS_M[1]:g} m"
            raise InputError(OPTION, f"{places_m[-1]:g} m", wanted)
        return cls(markers, places_m)

    @property
    def length_m(self) -> float:
        """From the first marker to the last, metres."""
        return float(self.places_m[-1])

    @property
    def pairs(self) -> Sequence[tuple[int, int]]:
        """Of markers, as indices that rise."""
        return list(combinations(range(len(self.markers)), 2))


@dataclass(frozen=True, slots=True, eq=False)
class WandRig:
    """A rig adjusted with a wand, in metres.

    Attributes:
        adjusted: cameras, places of the wand, and residuals in standard deviations.
        times: `(num_used,)` which of the times those are.
        off_m: how far placed markers are from the measured distance, each pair at each time placed
            without knowing it; the median.
        share: how far the scale may be off, as a share.
    """

    adjusted: Adjusted
    times: NDArray[np.int64]
    off_m: float
    share: float


def adjust_wand(
    rig: Rig, wand: Wand, keypoints_px: Floats, sigma_px: float, lenses: Floats | None = None
) -> WandRig:
    """Give a rig the scale of a wand, then adjust cameras and places of the wand together.

    Args:
        rig: the cameras, in whatever unit; the first stays where it is.
        wand: what was carried about.
        keypoints_px: `(num_cameras, num_times, num_markers, 2)` real pixels; NaN where not seen.
        sigma_px: standard deviation of either coordinate.
        lenses: what to expect of lenses, as `AdjustOptions` has it.

    Raises:
        InputError: when too few markers could be placed at one time, or their distances are not
            those of the wand.
    """
    points = _placed(rig, keypoints_px, sigma_px)
    shares = _shares(wand, points)
    alone = np.isfinite(points[..., 0]).sum(axis=0).tolist()
    counts = ", ".join(f"{name} {n}" for name, n in zip(wand.markers, alone, strict=True))
    number = int(np.isfinite(shares).any(axis=1).sum())
    if number < MIN_TIMES:
        raise InputError(
            f"wand: two of its markers were placed at {number} times ({counts}), expected "
            f"{MIN_TIMES} at least: turn it longer so that two cameras see both ends, or sample "
            "more frames (--rate)"
        )
    if min(alone) < MIN_TIMES // 3:
        least = MIN_TIMES // 3
        raise InputError(f"wand: markers were placed at times: {counts}, expected {least} at least")
    factor, spread = _checked(wand, shares)
    rig, points = Move(factor, np.eye(3), np.zeros(3)).rig(rig), factor * points
    known = np.flatnonzero(np.isfinite(shares).any(axis=1))
    times = known[np.abs(np.nanmedian(shares[known], axis=1) / factor - 1) < MOST_SPREAD]
    if len(times) > MOST_POINTS:
        times = times[np.linspace(0, len(times) - 1, MOST_POINTS).round().astype(int)]
    row_m = np.zeros((len(wand.markers), 3))
    row_m[:, 0] = wand.places_m
    adjusted = adjust_boards(
        rig, _along(wand, points[times]), row_m, keypoints_px[:, times], sigma_px,
        AdjustOptions(OUTLIER_SIGMAS, lenses=lenses),
    )  # fmt: skip
    again = _placed(adjusted.rig, keypoints_px[:, times], sigma_px)
    known_m = np.array([wand.places_m[b] - wand.places_m[a] for a, b in wand.pairs])
    off_m = float(np.nanmedian(np.abs(known_m / _shares(wand, again) - known_m)))
    share = float(np.hypot(MEASURED_M / wand.length_m, spread / np.sqrt(len(times))))
    return WandRig(adjusted, times, off_m, share)


def _placed(rig: Rig, keypoints_px: Floats, sigma_px: float) -> Floats:
    """Return `(num_times, num_markers, 3)`, each marker by itself; NaN where it was not placed."""
    flat = keypoints_px.reshape(len(rig), -1, 2)
    points = place_points(rig, flat, np.full(flat.shape[:2], sigma_px))
    return points.reshape(*keypoints_px.shape[1:3], 3)


def _shares(wand: Wand, points: Floats) -> Floats:
    """Return `(num_times, num_pairs)` measured lengths over placed ones; NaN where not placed."""
    lengths = np.stack([
        np.linalg.norm(points[:, a] - points[:, b], axis=-1)
        / (wand.places_m[b] - wand.places_m[a])
        for a, b in wand.pairs
    ], axis=1)  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(lengths > 0, 1 / lengths, np.nan))


def _along(wand: Wand, points: Floats) -> Floats:
    """Return `(num_times, 4, 4)` from the row along x to where its markers were placed.

    Args:
        wand: the row.
        points: `(num_times, num_markers, 3)` metres, two at least of each time; NaN where not.
    """
    there = np.isfinite(points[..., 0])
    first, last = there.argmax(axis=1), there.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
    each = np.arange(len(points))
    x = points[each, last] - points[each, first]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(x, np.eye(3)[np.abs(x).argmin(axis=1)])
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    Ts = np.tile(np.eye(4), (len(points), 1, 1))
    Ts[:, :3, :3] = np.stack([x, y, np.cross(x, y)], axis=-1)
    Ts[:, :3, 3] = np.nanmean(points - wand.places_m[:, None] * x[:, None], axis=1)
    return Ts


def _checked(wand: Wand, shares: Floats) -> tuple[float, float]:
    """Return a unit's metres and the lengths' spread as a share; refuse another wand."""
    names = [f"{wand.markers[a]} to {wand.markers[b]}" for a, b in wand.pairs]
    middle = np.nanmedian(shares, axis=0)
    spread = 1.4826 * np.nanmedian(np.abs(shares / middle - 1), axis=0)
    worst = int(spread.argmax())
    if spread[worst] > MOST_SPREAD:
        raise InputError(
            f"wand: {names[worst]} changes its length by {100 * spread[worst]:.0f} % from time to "
            "time, expected a stiff wand: something else has the colour of a marker, or the films "
            "are not in step (--offset)"
        )
    factor = float(np.median(middle))
    unlike = np.abs(middle / factor - 1)
    if unlike.max() > MOST_UNLIKE:
        known_m = np.array([wand.places_m[b] - wand.places_m[a] for a, b in wand.pairs])
        placed = known_m / middle
        long, short = int(placed.argmax()), int(placed.argmin())
        raise InputError(
            f"wand: {names[short]} is placed {placed[short] / placed[long]:.2f} times as long as "
            f"{names[long]}, expected {known_m[short] / known_m[long]:.2f}: name the markers in "
            "their order along the wand, with their distances from the first"
        )
    return factor, float(np.nanmedian(spread))
