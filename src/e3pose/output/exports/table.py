"""CSV and Parquet: a row per slot and joint or person, metres, z up, and joint angles in degrees.

Angles follow ISB definitions where keypoints allow. Keypoints show where joints are, not how bones
turn about themselves. So what follows from directions alone is here: flexion of elbow and knee,
elevation of the arm and its plane (Wu et al., J. Biomechanics 38 (2005) 981), and, for want of a
pelvis that could tilt by itself, the thigh against the trunk (`docs/reference/export.md`).

The frames of the trunk and of the shoulders have x ahead, y up along the trunk, z to the right,
as the ISB has them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.model.people import People
from e3pose.model.skeleton import MEANS, Skeleton
from e3pose.model.take import MEASURED, MISSING, ORIGINS, Motion, Take
from e3pose.output.exports.base import ExportSettings
from e3pose.output.exports.wide import write_wide
from e3pose.store.export import long_columns, write_tables
from e3pose.store.times import iso_text

DECIMALS_M, DECIMALS_DEG = 5, 2
SIDES = (("left", -1.0), ("right", 1.0))
CHUNK = 5000  # slots of a person that are written at once: each value is an object
LEAST_ELEVATION_DEG = 15.0  # below which an arm has no plane of elevation
UP = np.array([0.0, 0.0, 1.0])


def write_csv(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take, person after person; missing is an empty cell."""
    rows = write_tables(_tables(take, settings), dest, "csv")
    return f"{rows} rows, metres, z up"


def write_parquet(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the same columns as `write_csv`, missing as null; or an archive."""
    if settings.layout == "archive":
        return write_wide(take, dest, settings)
    rows = write_tables(_tables(take, settings), dest, "parquet")
    return f"{rows} rows, metres, z up"


def _tables(take: Take, settings: ExportSettings) -> Iterator[dict[str, Any]]:
    for motion in settings.progress(take.motions, len(take.motions), "write"):
        there = np.flatnonzero(motion.known.any(axis=1))
        for begin in range(0, len(there), CHUNK):
            yield _columns(take, motion, there[begin : begin + CHUNK], settings)


def _columns(
    take: Take, motion: Motion, there: Integers, settings: ExportSettings
) -> dict[str, Any]:
    slots = motion.first + there
    columns: dict[str, Any] = {
        "slot": slots.tolist(),
        "time": (slots * take.interval_s).round(6).tolist(),
    }
    if take.started_ns is not None:
        interval_ns = take.interval_s * 1e9
        time_ns = [take.started_ns + round(slot * interval_ns) for slot in slots.tolist()]
        columns["time"] = [iso_text(ns) for ns in time_ns]
        columns["time_ns"] = time_ns
    if settings.layout == "long" and not settings.angles:
        people = People(
            np.full(len(there), motion.track_id), motion.joints_m[there],
            np.where(motion.known[there], np.maximum(motion.scores[there], 1e-9), 0.0),
            motion.origin[there] == MEASURED, motion.sigma_m[there],
        )  # fmt: skip
        return long_columns(columns, people, take.skeleton.joints)
    columns["track"] = [motion.track_id] * len(there)
    names = np.array(["", *ORIGINS[1:]], dtype=object)
    for index, joint in enumerate(take.skeleton.joints):
        known = motion.origin[there, index] != MISSING
        for axis, letter in enumerate("xyz"):
            columns[f"{joint}_{letter}"] = _cells(motion.joints_m[there, index, axis], DECIMALS_M)
        columns[f"{joint}_sigma"] = _cells(motion.sigma_m[there, index], DECIMALS_M)
        scores = np.where(known, motion.scores[there, index], np.nan)
        columns[f"{joint}_score"] = _cells(scores, 4)
        columns[f"{joint}_origin"] = names[motion.origin[there, index]].tolist()
    if settings.angles:
        for name, degrees in joint_angles(motion.joints_m[there], take.skeleton).items():
            columns[name] = _cells(degrees, DECIMALS_DEG)
    return columns


def _cells(values: Floats, decimals: int) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values.round(decimals).tolist()]


def joint_angles(joints_m: Floats, skeleton: Skeleton) -> dict[str, Floats]:
    """Return angles by name, `(num_frames,)` degrees each; NaN where a joint is missing.

    Args:
        joints_m: `(num_frames, num_joints, 3)` metres, z up, NaN where missing.
        skeleton: of the joints; angles of joints that it lacks are left out.
    """
    found: dict[str, Floats] = {}
    body = _Body(joints_m, skeleton)
    for side, sign in SIDES:
        hip, knee, ankle = (f"{side}_{name}" for name in ("hip", "knee", "ankle"))
        shoulder, elbow, wrist = (f"{side}_{name}" for name in ("shoulder", "elbow", "wrist"))
        if body.has(hip, knee, ankle):
            found[f"{side}_knee_flexion_deg"] = _bend(body, hip, knee, ankle)
        if body.has(shoulder, elbow, wrist):
            found[f"{side}_elbow_flexion_deg"] = _bend(body, shoulder, elbow, wrist)
        if not body.has("left_hip", "right_hip", "left_shoulder", "right_shoulder"):
            continue
        if body.has(hip, knee):
            ahead, up, right = _frame(body, "hip")
            thigh = unit(body[knee] - body[hip])
            found[f"{side}_thigh_trunk_flexion_deg"] = _degrees(
                np.arctan2(dot(thigh, ahead), -dot(thigh, up))
            )
            found[f"{side}_thigh_trunk_abduction_deg"] = _degrees(
                np.arcsin(np.clip(sign * dot(thigh, right), -1, 1))
            )
        if body.has(shoulder, elbow):
            ahead, up, right = _frame(body, "shoulder")
            arm = unit(body[elbow] - body[shoulder])
            elevation = _degrees(np.arccos(np.clip(-dot(arm, up), -1, 1)))
            plane = _degrees(np.arctan2(dot(arm, ahead), sign * dot(arm, right)))
            found[f"{side}_shoulder_elevation_deg"] = elevation
            found[f"{side}_shoulder_plane_deg"] = np.where(
                elevation > LEAST_ELEVATION_DEG, plane, np.nan
            )
    if body.has("left_hip", "right_hip", "left_shoulder", "right_shoulder"):
        found.update(_trunk(body))
    return found


class _Body:
    """Joints by name, with the means of others."""

    def __init__(self, joints_m: Floats, skeleton: Skeleton) -> None:
        self._joints_m, self._names = joints_m, skeleton.joints

    def has(self, *names: str) -> bool:
        return set(names) <= set(self._names)

    def __getitem__(self, name: str) -> Floats:
        if name in self._names:
            return np.asarray(self._joints_m[:, self._names.index(name)])
        return np.asarray(sum(self[part] for part in MEANS[name]) / len(MEANS[name]))


def _bend(body: _Body, near: str, middle: str, far: str) -> Floats:
    """Return by how much a joint is bent: 0 where its two limbs are in line."""
    first, second = unit(body[middle] - body[near]), unit(body[far] - body[middle])
    return _degrees(np.arccos(np.clip(dot(first, second), -1, 1)))


def _frame(body: _Body, girdle: str) -> tuple[Floats, Floats, Floats]:
    """Return ahead, up and right of the trunk, turned as hips or shoulders are."""
    up = unit(_middle(body, "shoulder") - _middle(body, "hip"))
    across = body[f"right_{girdle}"] - body[f"left_{girdle}"]
    right = unit(across - dot(across, up)[:, None] * up)
    return np.cross(up, right), up, right


def _trunk(body: _Body) -> dict[str, Floats]:
    """Return how the trunk leans against the vertical, and is turned in itself."""
    trunk = unit(_middle(body, "shoulder") - _middle(body, "hip"))
    hips = body["left_hip"] - body["right_hip"]
    left = unit(np.concatenate([hips[:, :2], np.zeros((len(hips), 1))], axis=1))
    ahead = np.cross(left, UP)
    shoulders = body["left_shoulder"] - body["right_shoulder"]
    heading = [np.arctan2(each[:, 1], each[:, 0]) for each in (shoulders, hips)]
    twist = (heading[0] - heading[1] + np.pi) % (2 * np.pi) - np.pi
    return {
        "trunk_lean_deg": _degrees(np.arccos(np.clip(trunk[:, 2], -1, 1))),
        "trunk_lean_forward_deg": _degrees(np.arctan2(dot(trunk, ahead), trunk[:, 2])),
        "trunk_lean_left_deg": _degrees(np.arctan2(dot(trunk, left), trunk[:, 2])),
        "trunk_twist_left_deg": _degrees(twist),
    }


def _middle(body: _Body, girdle: str) -> Floats:
    return np.asarray((body[f"left_{girdle}"] + body[f"right_{girdle}"]) / 2)


def dot(a: Floats, b: Floats) -> Floats:
    """Return products of vectors on the last axis."""
    return np.asarray((a * b).sum(axis=-1))


def unit(vectors: Floats) -> Floats:
    """Return vectors of length 1 on the last axis; NaN for vectors without a length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 1e-9, length, np.nan))


def _degrees(radians: Floats) -> Floats:
    return np.asarray(np.degrees(radians))
