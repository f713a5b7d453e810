"""Joint angles in degrees, by ISB definitions where keypoints allow.

Keypoints show where joints are, not how bones turn about themselves. So what follows from
directions alone is here: flexion of elbow and knee, elevation of the arm and its plane (Wu et al.,
J. Biomechanics 38 (2005) 981), and, for want of a pelvis that could tilt by itself, the thigh
against the trunk. `docs/reference/export.md` has the table.

The frames of the trunk and of the shoulders have x ahead, y up along the trunk, z to the right,
as the ISB has them.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import MEANS, Skeleton

SIDES = (("left", -1.0), ("right", 1.0))
LEAST_ELEVATION_DEG = 15.0  # below which an arm has no plane of elevation
UP = np.array([0.0, 0.0, 1.0])


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
            thigh = _unit(body[knee] - body[hip])
            found[f"{side}_thigh_trunk_flexion_deg"] = _degrees(
                np.arctan2(_dot(thigh, ahead), -_dot(thigh, up))
            )
            found[f"{side}_thigh_trunk_abduction_deg"] = _degrees(
                np.arcsin(np.clip(sign * _dot(thigh, right), -1, 1))
            )
        if body.has(shoulder, elbow):
            ahead, up, right = _frame(body, "shoulder")
            arm = _unit(body[elbow] - body[shoulder])
            elevation = _degrees(np.arccos(np.clip(-_dot(arm, up), -1, 1)))
            plane = _degrees(np.arctan2(_dot(arm, ahead), sign * _dot(arm, right)))
            found[f"{side}_shoulder_elevation_deg"] = elevation
            found[f"{side}_shoulder_plane_deg"] = np.where(
                elevation > LEAST_ELEVATION_DEG, plane, np.nan
            )
    if body.has("left_hip", "right_hip", "left_shoulder", "right_shoulder"):
        found.update(_trunk(body))
    return found


class _Body:
    """Joints by name, also those that are means of others."""

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
    first, second = _unit(body[middle] - body[near]), _unit(body[far] - body[middle])
    return _degrees(np.arccos(np.clip(_dot(first, second), -1, 1)))


def _frame(body: _Body, girdle: str) -> tuple[Floats, Floats, Floats]:
    """Return ahead, up and right of the trunk, turned as hips or shoulders are."""
    up = _unit(_middle(body, "shoulder") - _middle(body, "hip"))
    across = body[f"right_{girdle}"] - body[f"left_{girdle}"]
    right = _unit(across - _dot(across, up)[:, None] * up)
    return np.cross(up, right), up, right


def _trunk(body: _Body) -> dict[str, Floats]:
    """Return how the trunk leans against the vertical, and is turned in itself."""
    trunk = _unit(_middle(body, "shoulder") - _middle(body, "hip"))
    hips = body["left_hip"] - body["right_hip"]
    left = _unit(np.concatenate([hips[:, :2], np.zeros((len(hips), 1))], axis=1))
    ahead = np.cross(left, UP)
    shoulders = body["left_shoulder"] - body["right_shoulder"]
    heading = [np.unwrap(np.arctan2(each[:, 1], each[:, 0])) for each in (shoulders, hips)]
    twist = (heading[0] - heading[1] + np.pi) % (2 * np.pi) - np.pi
    return {
        "trunk_lean_deg": _degrees(np.arccos(np.clip(trunk[:, 2], -1, 1))),
        "trunk_lean_forward_deg": _degrees(np.arctan2(_dot(trunk, ahead), trunk[:, 2])),
        "trunk_lean_left_deg": _degrees(np.arctan2(_dot(trunk, left), trunk[:, 2])),
        "trunk_twist_left_deg": _degrees(twist),
    }


def _middle(body: _Body, girdle: str) -> Floats:
    return np.asarray((body[f"left_{girdle}"] + body[f"right_{girdle}"]) / 2)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(axis=-1))


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 1e-9, length, np.nan))


def _degrees(radians: Floats) -> Floats:
    return np.asarray(np.degrees(radians))
