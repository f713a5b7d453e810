"""Histories of people as the attention-LSTM takes them, by the kernels that a running edge uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.predict.normalise import LEFT_RIGHT, NUM_COMMON, NUM_CONTEXT, NUM_FEATURES


@dataclass(frozen=True, slots=True, eq=False)
class Normalised:
    """The histories of all people as the network takes them, and the way back.

    Attributes:
        features: `(num_slots, num_tracks, NUM_FEATURES)` float32, oldest slot first.
        context: `(num_tracks, NUM_CONTEXT)` float32.
        centre_m: `(num_tracks, 3)` where the person's frame is in the world.
        heading: `(num_tracks, 2)` the unit vector in the floor plane from their right to their
            left.
        speed_m: `(num_tracks,)` root mean square motion of a joint per slot.
        seen: `(num_tracks, NUM_COMMON)` joints that the history shows at all.
        newest_m: `(num_tracks, NUM_COMMON, 3)` world metres in the newest slot, gaps closed.
    """

    features: NDArray[np.float32]
    context: NDArray[np.float32]
    centre_m: Floats
    heading: Floats
    speed_m: Floats
    seen: NDArray[np.bool_]
    newest_m: Floats


def to_common(joints_m: Floats, columns: NDArray[np.int64]) -> Floats:
    """Return `(*batch, NUM_COMMON, 3)` of `(*batch, num_joints, 3)`, NaN where missing.

    Args:
        joints_m: of a skeleton.
        columns: `common_columns` of that.
    """
    from e3pose.predict.kernels.history import common_joints

    common = np.empty((*joints_m.shape[:-2], len(columns), 3))
    poses = np.ascontiguousarray(joints_m, dtype=np.float64).reshape(-1, *joints_m.shape[-2:])
    common_joints(poses, columns, common.reshape(-1, len(columns), 3))
    return common


def fill_gaps(history_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Close gaps as if a missing joint moved with the person and evenly between its neighbours.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, NaN where missing.

    Returns:
        The history without gaps, 0 for joints that it never shows, and
        `(num_slots, num_tracks, num_joints)` which of it was measured.
    """
    from e3pose.predict.kernels.history import close_gaps

    filled, measured = np.empty(history_m.shape), np.empty(history_m.shape[:3], dtype=bool)
    close_gaps(np.ascontiguousarray(history_m, dtype=np.float64), filled, measured)
    return filled, measured


def last_slots(history_m: Floats, num_slots: int) -> Floats:
    """Return `(num_slots, num_tracks, num_joints, 3)`: the newest slots, NaN before the first."""
    history_m = history_m[-num_slots:]
    if len(history_m) == num_slots:
        return history_m
    lacking = np.full((num_slots - len(history_m), *history_m.shape[1:]), np.nan)
    return np.concatenate([lacking, history_m])


def normalise(history_m: Floats, interval_s: float | Floats, num_slots: int) -> Normalised:
    """Express histories as the network takes them.

    Args:
        history_m: `(any number of slots, num_tracks, NUM_COMMON, 3)` metres, oldest first, NaN
            where missing.
        interval_s: seconds per slot, one number or `(num_tracks,)`.
        num_slots: how many slots the network looks back; a longer history is cut, a shorter one
            counts as missing before it began.
    """
    from e3pose.predict.kernels.history import describe

    history_m = last_slots(history_m, num_slots)
    num_tracks = history_m.shape[1]
    filled, measured = fill_gaps(history_m)
    normal = Normalised(
        features=np.empty((num_slots, num_tracks, NUM_FEATURES), dtype=np.float32),
        context=np.empty((num_tracks, NUM_CONTEXT), dtype=np.float32),
        centre_m=np.empty((num_tracks, 3)),
        heading=np.empty((num_tracks, 2)),
        speed_m=np.empty(num_tracks),
        seen=np.empty((num_tracks, NUM_COMMON), dtype=bool),
        newest_m=filled[-1],
    )
    intervals_s = np.empty(num_tracks)
    intervals_s[:] = interval_s
    describe(
        filled,
        measured,
        intervals_s,
        np.array(LEFT_RIGHT),
        normal.features,
        normal.context,
        normal.centre_m,
        normal.heading,
        normal.speed_m,
        normal.seen,
    )
    return normal


def to_person(normal: Normalised, world_m: Floats) -> Floats:
    """Return `(*leads, num_tracks, NUM_COMMON, 3)` of the world in the people's own frames."""
    cosine, sine = normal.heading[:, :1], normal.heading[:, 1:]
    place = world_m - normal.centre_m[:, None]
    own = np.empty_like(place)
    own[..., 0] = cosine * place[..., 0] + sine * place[..., 1]
    own[..., 1] = cosine * place[..., 1] - sine * place[..., 0]
    own[..., 2] = place[..., 2]
    return own
