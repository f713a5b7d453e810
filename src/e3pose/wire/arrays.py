"""Convert arrays, 2D poses and people to fields of messages, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.wire.messages import Array, View
from e3pose.wire.site_messages import Poses

MAX_PERSONS = 256
DTYPES = {name: np.dtype(f"<{name}") for name in ("f4", "f8", "i8", "b1")}


def pack(array: NDArray[Any]) -> Array:
    """Return an array as a message field: floats of 4 or 8 bytes, integers of 8, or flags.

    Raises:
        InputError: for another dtype.
    """
    name = array.dtype.str[1:]
    if name not in DTYPES:
        raise InputError(f"array: found {array.dtype}, expected one of {', '.join(DTYPES)}")
    return Array(name, array.shape, array.astype(DTYPES[name], copy=False).tobytes())


def pack_poses(poses: Poses2D) -> tuple[Array, Array]:
    """Return keypoints and scores as message fields; of too many people, those of best score."""
    highest = np.argsort(-poses.scores.sum(axis=1), kind="stable")[:MAX_PERSONS]
    scores = np.clip(poses.scores[highest], 0, 1).astype(np.float32)
    return pack(poses.keypoints_px[highest].astype(np.float32)), pack(scores)


def unpack(array: Array) -> NDArray[Any]:
    """Return the array with its own dtype and shape, read-only and without a copy.

    Args:
        array: of a message that `decode` has checked.
    """
    unpacked: NDArray[Any] = np.ndarray(array.shape, DTYPES[array.dtype], array.data)
    return unpacked


def poses_2d(view: View) -> Poses2D:
    """Return the 2D poses of a view, with NaN and score 0 where a keypoint is missing."""
    with np.errstate(invalid="ignore"):  # there are NaNs that NumPy warns of
        return Poses2D(unpack(view.keypoints_px), unpack(view.scores), view.unchanged_ns / 1e9)


def packed_people(people: People) -> tuple[Array, Array, Array, Array]:
    """Return people as the fields of `Poses` that hold them, from `track_ids` to `measured`."""
    joints_m, sigma_m = (pack(m.astype(np.float32)) for m in (people.joints_m, people.sigma_m))
    return pack(people.track_ids), joints_m, sigma_m, pack(people.measured)


def people_of(poses: Poses) -> People:
    """Return the people of a message; scores, which it lacks, are 1 where a joint is known."""
    return People(
        unpack(poses.track_ids),
        unpack(poses.joints_m),
        measured=unpack(poses.measured),
        sigma_m=unpack(poses.sigma_m),
    )
