"""Detection maps of cameras: the evidence of a missed detection by place.

A rig's geometry says which places lie inside an image, but not what stands between: a wall, a
shelf, people who always stand there, dirt on a lens. So the looks at people who were there are
counted per camera and place of the floor, and how many of them showed the person. Whether somebody
was there at a miss turns out later, when a camera shows the person again whom another one showed of
late: misses wait until then, and those of a track that ends say nothing about cameras.

A camera that shows people at a place with probability p leaves, by a miss, 1 - p of the odds that
somebody is there. Existence counts it as that share of a miss in plain sight which the logarithms
have: log(1 - p) / log(1 - PLAIN).
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.scratch import Matches, Tracks
from e3pose.model.camera import Rig

# tuned: s | not recorded | rate beyond 25
FASTEST_S = 1 / 25  # above this rate a view says less, since successive ones say the same
# tuned: m | first guess | half and twice
CELL_M = 0.75  # people's own size, and the reach of a door
NUM_CELLS = 40  # capacity: along each side of the square around the cameras
# tuned: probability | simulated, `one-sided`, `l-hall`, `shaft`, `dying-cameras`, seeds 601 to 606:
#   0.8 and 0.95 within 3 % in error with misses, 0.95 with more ghosts; 0.7 keeps ghosts | half and
#   twice
PLAIN = 0.9  # detections of a look in plain sight: what is thought of places nobody was seen at
# tuned: looks | simulated, `one-sided`, `l-hall`, `shaft`, `dying-cameras`, seeds 601 to 606: 6
#   looks find blind cameras later | detection map
PRIOR_VIEWS = 2.0  # that this counts for
# tuned: looks | first guess | half and twice
MOST_VIEWS = 60.0  # kept per place, a few seconds of one person: things get moved
VIEWS, SHOWN = 0, 1  # layout: of the last axis
# So many cameras must have shown a person of late to prove that one is there: what lives on the
# detections of one camera alone may be a ghost, whose misses would say that all others are blind.
# A track that no camera has shown for as long ends.
# tuned: cameras, s | the fewest that a ghost of one camera is not; simulated, seeds 601 to 608,
#   `dying-cameras`, one camera by `information`: false people 1.8 to 0.9 % | half and twice
PROOF_CAMERAS, PROOF_S = 2, 1.0
LAST = NUM_CELLS - 1.001  # numerics


def corner_m(rig: Rig) -> Floats:
    """Return `(2,)`: where on the floor the first cell begins."""
    return np.asarray(rig.centers_m[:, :2].mean(axis=0) - NUM_CELLS * CELL_M / 2)


def nothing_known(rig: Rig) -> Floats:
    """Return `(num_cameras, NUM_CELLS, NUM_CELLS, 2)` counts before the first slot."""
    return np.zeros((len(rig), NUM_CELLS, NUM_CELLS, 2))


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
    """Scale counts beyond `MOST_VIEWS` down to it."""
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
