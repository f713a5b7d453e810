"""Blindness: the loops of `filter.blindness`, for the views of one slot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.blindness import (
    CELL_M,
    FASTEST_S,
    MOST_VIEWS,
    NUM_CELLS,
    PLAIN,
    PRIOR_VIEWS,
    PROOF_CAMERAS,
    PROOF_S,
    SHOWN,
    VIEWS,
)
from e3pose.estimate.filter.kernels.scratch import Matches, Tracks
from e3pose.runtime.kernel import kernel

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LAST = NUM_CELLS - 1.001  # numerics


@kernel
def chance(detection_map: Floats, place_m: Floats, corner_m: Floats) -> float:
    """Return the probability that a camera detects a person at a place, in (0, 1).

    Args:
        detection_map: `(num_cells, num_cells, 2)` of the camera; the four cells around the place
            count for as much as it is near to them.
        place_m: `(2,)` on the floor.
        corner_m: of the cells.
    """
    column, right = cell(place_m[0] - corner_m[0])
    row, up = cell(place_m[1] - corner_m[1])
    total, kind = PRIOR_VIEWS, PRIOR_VIEWS * PLAIN
    for a in range(2):
        for b in range(2):
            weight = (right if a else 1.0 - right) * (up if b else 1.0 - up)
            total += weight * detection_map[column + a, row + b, 0]
            kind += weight * detection_map[column + a, row + b, 1]
    return kind / total


@kernel
def proof(detection_map: Floats, place_m: Floats, corner_m: Floats) -> float:
    """Return the evidence of a miss at a place, as a share of a miss without obstacles."""
    missing = 1.0 - chance(detection_map, place_m, corner_m)
    if missing <= 1.0 - PLAIN:
        return 1.0
    return math.log(missing) / math.log(1.0 - PLAIN)


@kernel
def learn_detection_map(
    num_tracks: int,
    dt: float,
    corner_m: Floats,
    arrived: Flags,
    matches: Matches,
    detection_map: Floats,
    tracks: Tracks,
) -> None:
    """Count detections and misses of confirmed people; other misses wait."""
    share = dt / FASTEST_S if dt < FASTEST_S else 1.0
    num_cameras = len(arrived)
    for track in range(num_tracks):
        there, recent = False, 0
        for camera in range(num_cameras):
            recent += tracks.last_seen_s[track, camera] < PROOF_S
            if arrived[camera]:
                if matches.assigned[camera, track] >= 0:
                    there = True
                elif matches.inside[camera, track]:
                    tracks.missed[track, camera] += share
        proved = there and recent >= PROOF_CAMERAS
        matches.taught[track] = proved and tracks.confirmed[track]
        for camera in range(num_cameras):
            if matches.taught[track]:
                hit = arrived[camera] and matches.assigned[camera, track] >= 0
                shown = share if hit else 0.0
                views = tracks.missed[track, camera] + shown
                if views > 0.0:
                    _add(detection_map[camera], matches.places_m[track], corner_m, views, shown)
            if there:
                tracks.missed[track, camera] = 0.0
    for track in range(num_tracks):
        if matches.taught[track]:
            for camera in range(num_cameras):
                _forget(detection_map[camera], matches.places_m[track], corner_m)


@kernel
def _add(
    detection_map: Floats, place_m: Floats, corner_m: Floats, views: float, shown: float
) -> None:
    column, right = cell(place_m[0] - corner_m[0])
    row, up = cell(place_m[1] - corner_m[1])
    for a in range(2):
        for b in range(2):
            weight = (right if a else 1.0 - right) * (up if b else 1.0 - up)
            detection_map[column + a, row + b, VIEWS] += weight * views
            detection_map[column + a, row + b, SHOWN] += weight * shown


@kernel
def _forget(detection_map: Floats, place_m: Floats, corner_m: Floats) -> None:
    """Scale what is beyond `MOST_VIEWS` down to it."""
    column, _ = cell(place_m[0] - corner_m[0])
    row, _ = cell(place_m[1] - corner_m[1])
    for a in range(2):
        for b in range(2):
            views = detection_map[column + a, row + b, VIEWS]
            if views > MOST_VIEWS:
                detection_map[column + a, row + b, VIEWS] *= MOST_VIEWS / views
                detection_map[column + a, row + b, SHOWN] *= MOST_VIEWS / views


@kernel
def cell(offset_m: float) -> tuple[int, float]:
    """Return the lower of the two nearest cells along an axis, and the weight of the upper one."""
    position = offset_m / CELL_M - 0.5
    position = 0.0 if not position > 0.0 else LAST if position > LAST else position
    low = math.floor(position)
    return low, position - low
