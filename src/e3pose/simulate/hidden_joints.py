"""Self-occlusion, occlusion by other people and by objects: which joints a camera sees.

A body is a set of capsules around its bones. A joint is hidden when the straight line from it to
the camera runs through a capsule; `cover` says how squarely, from 0 (grazing) to 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.simulate.occluders import Occluder

# Capsules between points of the body: COCO-17 joints, then 17 mid-ear, 18 mid-shoulder, 19 mid-hip.
MID_EAR, MID_SHOULDER, MID_HIP = 17, 18, 19
CAPSULES = np.array(
    [[MID_EAR, MID_EAR], [MID_SHOULDER, MID_HIP], [5, 11], [6, 12],
     [5, 7], [6, 8], [7, 9], [8, 10], [11, 13], [12, 14], [13, 15], [14, 16]]
)  # fmt: skip
RADII_M = np.array(
    [0.090, 0.105, 0.070, 0.070, 0.045, 0.045, 0.038, 0.038, 0.070, 0.070, 0.05, 0.05]
)
SOFT_M = 0.04  # a line this deep inside a capsule is fully covered
OWN_SHORT_M = 0.09  # a joint's own flesh up to here does not hide it
BODY_RADIUS_M = 1.0  # a person, arms stretched out, lies within this of the hips
CHUNK, OWN_CHUNK = 4096, 512
BENT = 0.05  # radians by which a straight bone may bulge over its ends, seen as angles


def _own_capsules() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of joint and own capsule that may hide it: none that the joint belongs to."""
    belongs = {
        5: (2, 4), 6: (3, 5), 7: (4, 6), 8: (5, 7), 9: (6,), 10: (7,),
        11: (2, 8), 12: (3, 9), 13: (8, 10), 14: (9, 11), 15: (10,), 16: (11,),
    }  # fmt: skip
    # The face hides behind the head itself; the limbs that matter to the rest are big ones.
    pairs = [
        (joint, capsule)
        for joint in range(17)
        for capsule in range(len(CAPSULES))
        if (capsule == 0) == (joint < 5) and (joint < 5 or capsule not in belongs[joint])
    ]
    joints, capsules = np.array(pairs, dtype=np.int64).T
    return joints, capsules


OWN_JOINTS, OWN_CAPSULES = _own_capsules()
OWN_STARTS = np.searchsorted(OWN_JOINTS, np.arange(17))  # where each joint's pairs begin


def covered_by_others(centre_m: Floats, joints_m: Floats) -> Floats:
    """Return `(num_slots, num_persons, 17)`: how far other bodies cover each joint, 0 to 1.

    Args:
        centre_m: `(3,)` the camera.
        joints_m: `(num_slots, num_persons, 17, 3)` metres, NaN for people who are away.
    """
    return covered_by_whom(centre_m, joints_m)[0]


def covered_by_whom(centre_m: Floats, joints_m: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return `(num_slots, num_persons, 17)` twice: the same, and who covers it most, -1 for nobody.

    Args:
        centre_m: `(3,)` the camera.
        joints_m: `(num_slots, num_persons, 17, 3)` metres, NaN for people who are away.
    """
    points = _with_middles(joints_m)
    cover = np.zeros(joints_m.shape[:3])
    whom = np.full(joints_m.shape[:3], -1)
    hips = points[..., MID_HIP, :]
    bearing = np.arctan2(*np.moveaxis((hips - centre_m)[..., 1::-1], -1, 0))
    lines = _within(_outlines(centre_m, points), _pairs_in_line(centre_m, hips), bearing)
    for slots, seen, before, joints in _chunks(lines):
        bones = points[slots, before][:, CAPSULES]  # (num_lines, num_capsules, 2, 3)
        ends = joints_m[slots, seen, joints][:, None]
        most = _cover(centre_m, ends, bones[:, :, 0], bones[:, :, 1]).max(axis=-1)
        np.maximum.at(cover, (slots, seen, joints), most)
        hides = (most > 0) & (most == cover[slots, seen, joints])
        whom[slots[hides], seen[hides], joints[hides]] = before[hides]
    return cover, whom


def covered_by_self(centre_m: Floats, joints_m: Floats) -> Floats:
    """Return `(num_slots, num_persons, 17)`: how far the own body covers each joint, 0 to 1.

    Args:
        centre_m: `(3,)` the camera.
        joints_m: `(num_slots, num_persons, 17, 3)` metres, NaN for people who are away.
    """
    points = _with_middles(joints_m)
    cover = np.zeros(joints_m.shape[:3])
    present = np.stack(np.nonzero(np.isfinite(joints_m[:, :, 0, 0])))
    for slots, people in _chunks(present, OWN_CHUNK):
        body = points[slots, people]
        bones = body[:, CAPSULES[OWN_CAPSULES]]
        joints = body[:, OWN_JOINTS]
        towards = centre_m - joints
        distance = np.linalg.norm(towards, axis=-1, keepdims=True)
        ends = joints + towards * np.minimum(OWN_SHORT_M / np.maximum(distance, 1e-9), 1.0)
        found = _cover(centre_m, ends, bones[:, :, 0], bones[:, :, 1], RADII_M[OWN_CAPSULES])
        cover[slots, people] = np.maximum.reduceat(found, OWN_STARTS, axis=1)
    return cover


def behind_things(
    centre_m: Floats, joints_m: Floats, occluders: Sequence[Occluder]
) -> NDArray[np.bool_]:
    """Return `(num_slots, num_persons, 17)`: whether a thing of the scene hides each joint."""
    hidden = np.zeros(joints_m.shape[:3], dtype=bool)
    present = np.isfinite(joints_m[..., 0])
    joints = joints_m[present]
    for occluder in occluders:
        hidden[present] |= occluder.blocks(np.broadcast_to(centre_m, joints.shape), joints)
    return hidden


def _with_middles(joints_m: Floats) -> Floats:
    """Append the points between ears, shoulders and hips: `(*batch, 20, 3)`."""
    middles = [
        joints_m[..., [a, b], :].mean(axis=-2, keepdims=True) for a, b in ((3, 4), (5, 6), (11, 12))
    ]
    return np.concatenate([joints_m, *middles], axis=-2)


def _pairs_in_line(centre_m: Floats, hips_m: Floats) -> NDArray[np.int64]:
    """Return `(3, num_pairs)`: slot, person and another one who may stand before that person."""
    offset = hips_m - centre_m
    distance = np.linalg.norm(offset, axis=-1)
    with np.errstate(invalid="ignore"):
        angle_of_body = np.arcsin(np.minimum(BODY_RADIUS_M / np.maximum(distance, 1e-9), 1.0))
        unit = offset / np.maximum(distance, 1e-9)[..., None]
        between = np.arccos(np.clip(np.einsum("tpk,tqk->tpq", unit, unit), -1, 1))
        line = between < angle_of_body[:, :, None] + angle_of_body[:, None, :]
        line &= distance[:, None, :] < distance[:, :, None] + BODY_RADIUS_M
    line &= ~np.eye(hips_m.shape[1], dtype=bool)
    return np.stack(np.nonzero(line))


def _outlines(centre_m: Floats, points_m: Floats) -> Floats:
    """Return where bodies appear from a camera: `(num_slots, num_persons, 21, 2)` radians.

    The azimuth from that of the hips and the elevation of 20 points, and what to add on either
    side so that a box around them holds the whole body.
    """
    offset = points_m - centre_m
    ground = np.hypot(offset[..., 0], offset[..., 1])
    azimuth = np.arctan2(offset[..., 1], offset[..., 0])
    azimuth = azimuth - azimuth[..., MID_HIP : MID_HIP + 1]
    azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
    elevation = np.arctan2(offset[..., 2], ground)
    near = np.stack([ground, np.linalg.norm(offset, axis=-1)], axis=-1).min(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        margin = np.where(near > 0.5, np.arcsin(np.minimum(RADII_M.max() / near, 1.0)), np.pi)
    points = np.stack([azimuth, elevation], axis=-1)
    return np.concatenate([points, (margin + BENT)[:, :, None]], axis=2)


def _within(outlines: Floats, pairs: NDArray[np.int64], bearing: Floats) -> NDArray[np.int64]:
    """Return `(4, num_lines)`: slot, person, the one before and a joint that it may hide."""
    slots, seen, before = pairs
    body = outlines[slots, before]
    low = body[:, :-1].min(axis=1) - body[:, -1]
    high = body[:, :-1].max(axis=1) + body[:, -1]
    joints = outlines[slots, seen, :17]
    turned = bearing[slots, seen] - bearing[slots, before]
    azimuth = (joints[..., 0] + turned[:, None] + np.pi) % (2 * np.pi) - np.pi
    inside = (azimuth > low[:, None, 0]) & (azimuth < high[:, None, 0])
    inside &= (joints[..., 1] > low[:, None, 1]) & (joints[..., 1] < high[:, None, 1])
    rows, hidden = np.nonzero(inside)
    return np.stack([slots[rows], seen[rows], before[rows], hidden])


def _chunks(indices: NDArray[np.int64], size: int = CHUNK) -> list[NDArray[np.int64]]:
    """Split `(num_indices, num_pairs)` so that the work on one piece fits the cache."""
    return [indices[:, i : i + size] for i in range(0, indices.shape[1], size)]


def _cover(
    centre_m: Floats, ends: Floats, first: Floats, second: Floats, radii: Floats = RADII_M
) -> Floats:
    """Return `(*batch)`: how deep the lines from the camera to `ends` enter capsules, 0 to 1.

    The distance is that of two straight pieces in space (Ericson, Real-Time Collision Detection,
    section 5.1.9), with the nearest point on the bone found first for the whole line of sight.
    """
    direction = ends - centre_m
    bone = second - first
    offset = centre_m - first
    a = _dot(direction, direction)
    e = _dot(bone, bone)
    b = _dot(direction, bone)
    c = _dot(direction, offset)
    f = _dot(bone, offset)
    across = a * e - b * b
    along = np.clip((b * f - c * e) / np.maximum(across, 1e-12), 0.0, 1.0)
    up = np.clip((b * along + f) / np.maximum(e, 1e-12), 0.0, 1.0)
    along = np.clip((b * up - c) / np.maximum(a, 1e-12), 0.0, 1.0)
    gap = offset + direction * along[..., None] - bone * up[..., None]
    depth = radii - np.sqrt(_dot(gap, gap))
    return np.asarray(np.clip(depth / SOFT_M, 0.0, 1.0))


def _dot(a: Floats, b: Floats) -> Floats:
    """Return `(*batch)` products of `(*batch, 3)`: numpy sums along an axis of three slowly."""
    product = a * b
    return np.asarray(product[..., 0] + product[..., 1] + product[..., 2])
