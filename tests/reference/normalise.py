"""What the attention-LSTM sees of a person, in plain numpy: of many people at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.predict.kernels.history import (
    LONGEST_S,
    ROUGH_FLOOR_M,
    SHORTEST_S,
    SPEED_CEILING_M,
    SPEED_FLOOR_M,
)
from e3pose.predict.normalise import LEFT_RIGHT, NUM_COMMON, NUM_FEATURES
from e3pose_lab.prediction.normalise import Normalised, fill_gaps, last_slots


def normalise(history_m: Floats, interval_s: float | Floats, num_slots: int) -> Normalised:
    """Express histories as the network takes them.

    See `e3pose_lab.prediction.normalise.normalise`.
    """
    history_m = last_slots(history_m, num_slots)
    num_tracks = history_m.shape[1]
    filled, measured = fill_gaps(history_m)
    seen: NDArray[np.bool_] = np.asarray(measured.any(axis=0))
    weight = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    centre = np.einsum("nj,njc->nc", weight, filled[-1])
    left, cosine, sine = _heading(filled[-1], seen)

    features = np.zeros((num_slots, num_tracks, NUM_FEATURES), dtype=np.float32)
    grid = features.reshape(num_slots, num_tracks, 7, NUM_COMMON)
    place = (filled - centre[:, None]) * seen[..., None]
    turned = np.empty_like(place)
    turned[..., 0] = cosine * place[..., 0] + sine * place[..., 1]
    turned[..., 1] = cosine * place[..., 1] - sine * place[..., 0]
    turned[..., 2] = place[..., 2]
    motion = turned[1:] - turned[:-1]
    squares = np.einsum("tnjc,tnjc,nj->n", motion, motion, weight) / (num_slots - 1)
    speed = np.minimum(np.sqrt(squares + SPEED_FLOOR_M**2), SPEED_CEILING_M)
    bends = motion[1:] - motion[:-1]
    rough = np.einsum("tnjc,tnjc,nj->n", bends, bends, weight) / (num_slots - 2)
    grid[:, :, :3] = turned.swapaxes(2, 3)
    grid[1:, :, 3:6] = (motion / speed[:, None, None]).swapaxes(2, 3)
    grid[:, :, 6] = measured
    context = np.stack(
        [
            np.log(speed / 0.01),
            np.broadcast_to(np.log(np.clip(interval_s, SHORTEST_S, LONGEST_S) * 30), num_tracks),
            np.sqrt(rough) / speed,
            0.5 * np.log(rough / 0.01**2 + (ROUGH_FLOOR_M / 0.01) ** 2),
        ],
        axis=-1,
    ).astype(np.float32)
    return Normalised(features, context, centre, left, speed, seen, filled[-1])


def _heading(newest_m: Floats, seen: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Return the direction to the left `(num_tracks, 2)`, its cosine and sine `(num_tracks, 1)`."""
    across = np.zeros((len(newest_m), 2))
    for left, right in LEFT_RIGHT:
        both = (seen[:, left] & seen[:, right])[:, None]
        across += both * (newest_m[:, left, :2] - newest_m[:, right, :2])
    length = np.hypot(across[:, 0], across[:, 1])
    known = length > 1e-3
    unit = np.where(known[:, None], across / np.where(known, length, 1.0)[:, None], [1.0, 0.0])
    return unit, unit[:, :1], unit[:, 1:]


def to_world(normal: Normalised, places_m: Floats) -> Floats:
    """Return `(*leads, num_tracks, NUM_COMMON, 3)` of the people's own frames in the world."""
    cosine, sine = normal.heading[:, :1], normal.heading[:, 1:]
    world = np.empty_like(places_m)
    world[..., 0] = cosine * places_m[..., 0] - sine * places_m[..., 1]
    world[..., 1] = sine * places_m[..., 0] + cosine * places_m[..., 1]
    world[..., 2] = places_m[..., 2]
    world += normal.centre_m[:, None]
    return world
