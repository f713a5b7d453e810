"""A run as JSON lists for the page's 3D player, and the slot at which it opens. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.blind_slot import WORDS
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord
from e3pose.model.uncertainty import distance_within_m
from e3pose.recording import Recording, Truth

MAX_SLOTS = 1500  # a page with more becomes slow to open and its strips too fine to see
MAX_COORDINATES = 3_000_000  # about 20 MB of page
MAX_COORDINATE_M = 1000.0  # a joint further out is a mistake, and nothing to look at
FRUSTUM_SHARE = 0.06  # of the scene's size: how large cameras are drawn
NUM_COLOURS = 8  # of `COLOURS` in scene.js
BAND = 0.9  # share of cases in which a joint lies within its drawn distance
# What a camera did in a slot, as the codes of scene.js; in a blind slot no view arrived at all.
ASLEEP, AWAKE, LOST, BLIND = 0, 1, 2, 4
APART_M = 0.3  # between the middles of two people; nearer, one of them may not be there
ROUNDING = 1e-6


def stride(records: Sequence[SlotRecord]) -> int:
    """Return how many slots to advance between shown ones so that a page stays light."""
    coordinates = sum(record.people.joints_m.size for record in records)
    return max(1, math.ceil(len(records) / MAX_SLOTS), math.ceil(coordinates / MAX_COORDINATES))


def scene(recording: Recording, records: Sequence[SlotRecord]) -> dict[str, Any]:
    """Gather the drawing's data, with only lists, numbers and strings in it.

    Args:
        recording: the source: cameras, skeleton and, if any, truth.
        records: what its replay left behind, in slot order.

    Returns:
        The object that `player.js` and `charts.js` read; coordinates in whole millimetres, missing
        ones None. Long runs are thinned to every `stride`-th slot.
    """
    step = stride(records)
    shown = records[::step]
    track_ids = list(dict.fromkeys(int(i) for record in records for i in record.people.track_ids))
    number = {track_id: index for index, track_id in enumerate(track_ids)}
    chosen = colours(records)
    low, high = bounds(recording.rig, shown)
    size_m = FRUSTUM_SHARE * float((high - low).max())
    return {
        "stride": step,
        "numSlots": len(records),
        "slots": [record.slot for record in shown],
        "times": [round(record.time_s, 4) for record in shown],
        "start": opening_slot(recording.rig, shown),
        "tracks": track_ids,
        "colours": [chosen[track_id] for track_id in track_ids],
        "limbs": [list(limb) for limb in recording.skeleton.limbs],
        "neck": neck(recording.skeleton),
        "people": [_people(record, number) for record in shown],
        "truth": [_truth(recording.truth, record.slot) for record in shown],
        "truthLimbs": [list(i) for i in recording.truth.skeleton.limbs] if recording.truth else [],
        "cameras": list(recording.rig.titles.values()),
        "frustums": [millimetres(frustum(camera, size_m)) for camera in recording.rig.cameras],
        "low": millimetres(low),
        "high": millimetres(high),
        "floor": round(1000 * floor_m(shown)),
        "states": _by_camera(recording, [_states(record) for record in shown], digits=0),
        "blind": {
            record.slot: WORDS.get(record.blind, record.blind) for record in shown if record.blind
        },
        "occlusion": _by_camera(recording, [record.occlusion for record in shown]),
        "deficit": _by_camera(recording, [record.deficit for record in shown]),
        **_reasons(recording, records, shown),
    }


def _people(record: SlotRecord, number: Mapping[int, int]) -> list[list[Any]]:
    """Return for each person the track, the joints and, where it is known, how sure each joint is.

    The last are distances in millimetres that hold a joint in nine of ten cases.
    """
    within = distance_within_m(record.people.covariance_m2, BAND)
    people = []
    for track_id, joints_m, radii_m in zip(
        record.people.track_ids, record.people.joints_m, within, strict=True
    ):
        known = [millimetres(radii_m)] if np.isfinite(radii_m).any() else []
        people.append([number[int(track_id)], millimetres(joints_m), *known])
    return people


def _reasons(
    recording: Recording, records: Sequence[SlotRecord], shown: Sequence[SlotRecord]
) -> dict[str, Any]:
    """Return why the cameras of each shown slot were chosen, if anybody worked it out."""
    reasons = {record.reasons.slot: record.reasons for record in records if record.reasons}
    if not reasons:
        return {}
    unknown = np.full(len(recording.rig), np.nan)
    chosen = [reasons.get(record.slot) for record in shown]
    errors = [math.nan if each is None else each.error_m for each in chosen]
    return {
        "gain": _by_camera(recording, [unknown if r is None else r.gain_nats for r in chosen]),
        "price": _by_camera(recording, [unknown if r is None else r.price for r in chosen]),
        "expected": millimetres(np.array(errors)),
    }


def colours(records: Sequence[SlotRecord]) -> dict[int, int]:
    """Return each track's colour, an index below `NUM_COLOURS`, which it keeps.

    It is the track id's own (modulo the number of colours) unless somebody present at the same
    time has it already and another is free.
    """
    last = {int(i): record.slot for record in records for i in record.people.track_ids}
    chosen: dict[int, int] = {}
    present: list[int] = []
    for record in records:
        for track_id in map(int, record.people.track_ids):
            if track_id in chosen:
                continue
            present = [other for other in present if last[other] >= record.slot]
            taken = {chosen[other] for other in present}
            wanted = [(track_id + k) % NUM_COLOURS for k in range(NUM_COLOURS)]
            chosen[track_id] = next((c for c in wanted if c not in taken), wanted[0])
            present.append(track_id)
    return chosen


def bounds(rig: Rig, records: Sequence[SlotRecord]) -> tuple[Floats, Floats]:
    """Return the `(3,)` low and high corner, metres, of the cameras and all but stray joints."""
    low, high = rig.centers_m.min(axis=0), rig.centers_m.max(axis=0)
    joints = _all_joints(records)
    if len(joints):
        low = np.minimum(low, np.percentile(joints, 1, axis=0))
        high = np.maximum(high, np.percentile(joints, 99, axis=0))
    margin = max(0.5 - float((high - low).max()) / 2, 0.0)
    return low - margin, high + margin


def floor_m(records: Sequence[SlotRecord]) -> float:
    """Return the height to draw the floor at: 0 unless people stand clearly elsewhere."""
    joints = _all_joints(records)
    lowest = float(np.percentile(joints[:, 2], 1)) if len(joints) else 0.0
    return 0.0 if -0.3 < lowest < 0.5 else lowest


def frustum(camera: Camera, depth_m: float) -> Floats:
    """Return `(5, 3)` metres: the optical centre, then the image corners drawn at `depth_m`."""
    width, height = camera.image_size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    pixels = np.column_stack([corners - 0.5, np.ones(4)])
    in_camera = depth_m * pixels @ np.linalg.inv(camera.K).T
    return np.vstack([camera.center_m, in_camera @ camera.R + camera.center_m])


def _all_joints(records: Sequence[SlotRecord]) -> Floats:
    if not records:
        return np.zeros((0, 3))
    joints = np.concatenate([record.people.joints_m.reshape(-1, 3) for record in records])
    with np.errstate(invalid="ignore"):
        return np.asarray(joints[(np.abs(joints) < MAX_COORDINATE_M).all(axis=-1)])


def neck(skeleton: Skeleton) -> list[int]:
    """Return nose and shoulders of a skeleton without a neck, whose drawing would be headless."""
    names = ("nose", "left_shoulder", "right_shoulder")
    if "neck" in skeleton.joints or not set(names) <= set(skeleton.joints):
        return []
    return [skeleton.index(name) for name in names]


def _truth(truth: Truth | None, slot: int) -> list[list[int | None]]:
    if truth is None:
        return []
    people = truth.joints_m[slot]
    return [millimetres(person) for person in people if np.isfinite(person).any()]


def _states(record: SlotRecord) -> Floats:
    if record.blind:
        return np.full(len(record.selected), float(BLIND))
    return np.where(record.arrived, AWAKE, np.where(record.selected, LOST, ASLEEP)).astype(float)


def _by_camera(
    recording: Recording, rows: Sequence[Floats], digits: int = 3
) -> list[list[float | None]]:
    """Turn one row per slot into one list per camera, missing as None."""
    columns = np.array(rows, dtype=np.float64).reshape(len(rows), len(recording.rig)).T
    return [
        [round(v, digits) if math.isfinite(v) else None for v in row.tolist()] for row in columns
    ]


def millimetres(points_m: Floats) -> list[int | None]:
    """Return `(*batch, 3)` metres flattened to whole millimetres; None where NaN."""
    return [
        round(1000 * v) if abs(v) < MAX_COORDINATE_M else None
        for v in np.asarray(points_m, dtype=np.float64).ravel().tolist()
    ]


def opening_slot(rig: Rig, records: Sequence[SlotRecord]) -> int:
    """Return the index of the record to open a page at.

    It shows as many people as slots with anybody mostly do, each apart from the others, is not
    blind, and has cameras asleep, if such slots exist. Of these, half move less than at this moment
    at most, and its expected error is the nearest to their median; the middle one where nothing
    tells.
    """
    counts = np.array([len(record.people) for record in records], dtype=np.int64)
    if not counts.any():
        return 0
    often = np.bincount(counts[counts > 0])
    rows = np.flatnonzero(counts == len(often) - 1 - int(often[::-1].argmax()))
    apart = np.array([_apart(records[row]) for row in rows.tolist()])
    rows = _those(rows, apart)
    rows = _those(rows, np.array([not records[row].blind for row in rows.tolist()]))
    rows = _those(rows, np.array([records[row].selected.sum() < len(rig) for row in rows.tolist()]))
    speeds = np.array([_moved_m(records, row) for row in rows.tolist()])
    errors = np.array([_expected_m(records[row]) for row in rows.tolist()])
    known = np.isfinite(speeds) & np.isfinite(errors)
    if not known.any():
        return int(rows[len(rows) // 2])
    moving = known & (speeds >= (1 - ROUNDING) * np.median(speeds[known]))
    away = np.where(moving, np.abs(errors - np.median(errors[known])), np.inf)
    return int(rows[away.argmin()])


def _those(rows: NDArray[np.int64], wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the rows that are wanted; all if none is."""
    return rows[wanted] if wanted.any() else rows


def _middles(record: SlotRecord) -> Floats:
    """Return `(num_persons, 3)` means of the joints of each person, metres."""
    joints = record.people.joints_m
    known = np.isfinite(joints).all(axis=-1, keepdims=True)
    total = np.where(known, joints, 0.0).sum(axis=1)
    return np.asarray(total / np.maximum(known.sum(axis=1), 1))


def _apart(record: SlotRecord) -> bool:
    middles = _middles(record)
    distance = np.linalg.norm(middles[:, None] - middles[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return bool((distance >= APART_M).all())


def _moved_m(records: Sequence[SlotRecord], row: int) -> float:
    """Return how far the people of a slot have moved since the one before; NaN if unknown."""
    if row == 0:
        return np.nan
    before, now = records[row - 1], records[row]
    middles = dict(zip(before.people.track_ids.tolist(), _middles(before), strict=True))
    ids = now.people.track_ids.tolist()
    moved = [
        float(np.linalg.norm(middle - middles[track_id]))
        for track_id, middle in zip(ids, _middles(now), strict=True)
        if track_id in middles
    ]
    return float(np.mean(moved)) if moved else np.nan


def _expected_m(record: SlotRecord) -> float:
    """Return the mean expected error of the joints of a slot; NaN if unknown."""
    variance = np.trace(record.people.covariance_m2, axis1=-2, axis2=-1)
    known = np.isfinite(variance)
    return float(np.sqrt(variance[known]).mean()) if known.any() else np.nan
