"""What the attention-LSTM sees of a person: the same numbers in training and at run time.

Twelve limb joints, neck and head, wherever the person stands and whichever way they face; gaps
closed and marked; speeds in units of the person's own recent speed, so that slow and fast motion
look alike and an error means the same for both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.model.skeleton import MEANS, Skeleton

Floats = NDArray[np.float64]

COMMON_JOINTS = (
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "neck", "head",
)  # fmt: skip
NUM_COMMON = len(COMMON_JOINTS)
# The first of these that a skeleton has stands for the common joint; MEANS are tried last.
STAND_INS = {"neck": ("neck", "bottom_head"), "head": ("nose", "top_head")}
LEFT_RIGHT = ((0, 1), (6, 7))  # pairs that tell which way a person faces
NUM_FEATURES = 7 * NUM_COMMON  # of one person in one slot: position, motion, whether measured
NUM_CONTEXT = 4  # of one person: speed, slot length, roughness of that speed and in itself
ROUGH_FLOOR_M = 1e-4  # a slot; rougher than this is noise or motion
SPEED_FLOOR_M = 5e-4  # a slot; slower than this is standing still
SPEED_CEILING_M = 2.0  # a slot; faster is a mistake of the tracker
INTERVALS_S = (1 / 60, 1 / 5)  # slots that were learned; shorter and longer ones count as these
FAR_M = 1e4  # from the origin of the world; beyond it a position is taken for a mistake


@dataclass(frozen=True, slots=True, eq=False)
class Normalised:
    """The histories of all people as the network takes them, and the way back.

    Attributes:
        features: `(num_slots, num_tracks, NUM_FEATURES)` float32, oldest slot first.
        context: `(num_tracks, NUM_CONTEXT)` float32.
        centre_m: `(num_tracks, 3)` where the person's frame is in the world.
        heading: `(num_tracks, 2)` the unit vector in the floor plane from their right to their
            left.
        speed_m: `(num_tracks,)` root mean square motion of a joint in a slot.
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


def common_columns(skeleton: Skeleton) -> tuple[tuple[int, ...], ...]:
    """Return, per common joint, the columns of `skeleton` whose mean it is; empty if none."""
    columns: list[tuple[int, ...]] = []
    for joint in COMMON_JOINTS:
        for name in STAND_INS.get(joint, (joint,)):
            if name in skeleton.joints:
                columns.append((skeleton.joints.index(name),))
                break
        else:
            parts = MEANS.get(joint, ())
            has_all = bool(parts) and set(parts) <= set(skeleton.joints)
            columns.append(tuple(skeleton.joints.index(p) for p in parts) if has_all else ())
    return tuple(columns)


def to_common(joints_m: Floats, columns: tuple[tuple[int, ...], ...]) -> Floats:
    """Return `(*batch, NUM_COMMON, 3)` of `(*batch, num_joints, 3)`, NaN where missing."""
    first = [chosen[0] if chosen else 0 for chosen in columns]
    common: Floats = joints_m[..., first, :]
    for index, chosen in enumerate(columns):
        if len(chosen) != 1:
            common[..., index, :] = (
                joints_m[..., list(chosen), :].mean(axis=-2) if chosen else np.nan
            )
    return common


def fill_gaps(history_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Close gaps as if a missing joint moved with the person and evenly between its neighbours.

    Args:
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, NaN where missing.

    Returns:
        The history without gaps, 0 for joints that it never shows, and
        `(num_slots, num_tracks, num_joints)` which of it was measured.
    """
    with np.errstate(invalid="ignore"):
        measured = np.asarray((np.abs(history_m) < FAR_M).all(axis=-1))
    if measured.all():
        return history_m, measured
    num_slots, num_tracks, num_joints = measured.shape
    known = np.where(measured[..., None], history_m, 0.0)
    both = measured[1:] & measured[:-1]
    motion = np.einsum("tnjc,tnj->tnc", known[1:] - known[:-1], both)
    motion /= np.maximum(both.sum(axis=2), 1)[..., None]
    path = np.zeros((num_slots, num_tracks, 1, 3))
    np.cumsum(motion, axis=0, out=path[1:, :, 0])
    known -= path

    slot = np.arange(num_slots)[:, None, None]
    before = np.maximum.accumulate(np.where(measured, slot, -1), axis=0)
    after = np.minimum.accumulate(np.where(measured, slot, num_slots)[::-1], axis=0)[::-1]
    first = np.where(before < 0, np.minimum(after, num_slots - 1), before)
    last = np.where(after >= num_slots, first, after)
    share = (slot - first) * (first != last) / np.maximum(last - first, 1)
    row = np.arange(num_tracks * num_joints).reshape(num_tracks, num_joints)
    flat = known.reshape(-1, 3)
    start = flat[first * row.size + row]
    filled = start + share[..., None] * (flat[last * row.size + row] - start) + path
    filled *= np.asarray(measured.any(axis=0))[..., None]
    return filled, measured


def normalise(history_m: Floats, interval_s: float | Floats, num_slots: int) -> Normalised:
    """Express histories as the network takes them.

    Args:
        history_m: `(any number of slots, num_tracks, NUM_COMMON, 3)` metres, oldest first, NaN
            where missing.
        interval_s: seconds a slot, one number or `(num_tracks,)`.
        num_slots: how many slots the network looks back; a longer history is cut, a shorter one
            counts as missing before it began.
    """
    history_m = history_m[-num_slots:]
    num_tracks = history_m.shape[1]
    if len(history_m) < num_slots:
        lacking = np.full((num_slots - len(history_m), *history_m.shape[1:]), np.nan)
        history_m = np.concatenate([lacking, history_m])
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
            np.broadcast_to(np.log(np.clip(interval_s, *INTERVALS_S) * 30), num_tracks),
            np.sqrt(rough) / speed,
            0.5 * np.log(rough / 0.01**2 + (ROUGH_FLOOR_M / 0.01) ** 2),
        ],
        axis=-1,
    ).astype(np.float32)
    return Normalised(features, context, centre, left, speed, seen, filled[-1])


def to_world(normal: Normalised, places_m: Floats) -> Floats:
    """Return `(*leads, num_tracks, NUM_COMMON, 3)` of the people's own frames in the world."""
    cosine, sine = normal.heading[:, :1], normal.heading[:, 1:]
    world = np.empty_like(places_m)
    world[..., 0] = cosine * places_m[..., 0] - sine * places_m[..., 1]
    world[..., 1] = sine * places_m[..., 0] + cosine * places_m[..., 1]
    world[..., 2] = places_m[..., 2]
    world += normal.centre_m[:, None]
    return world


def to_person(normal: Normalised, world_m: Floats) -> Floats:
    """Return `(*leads, num_tracks, NUM_COMMON, 3)` of the world in the people's own frames."""
    cosine, sine = normal.heading[:, :1], normal.heading[:, 1:]
    place = world_m - normal.centre_m[:, None]
    own = np.empty_like(place)
    own[..., 0] = cosine * place[..., 0] + sine * place[..., 1]
    own[..., 1] = cosine * place[..., 1] - sine * place[..., 0]
    own[..., 2] = place[..., 2]
    return own


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
