"""Joint angles of postures that everybody can picture."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import BODY
from tests.output.exports.takes import turned

from e3pose.model.skeleton import COCO17, SHELF14
from e3pose.output.exports.table import joint_angles

UPRIGHT = BODY.copy()  # faces x, y to the left
for _side, _sign in ((0, 1.0), (1, -1.0)):
    UPRIGHT[[7 + _side, 9 + _side]] = [[0, _sign * 0.2, 1.1], [0, _sign * 0.2, 0.8]]
    UPRIGHT[[13 + _side, 15 + _side]] = [[0, _sign * 0.12, 0.5], [0, _sign * 0.12, 0.08]]


def moved(joints: list[int], about: int, angle_deg: float, axis: int) -> dict[str, float]:
    """Return the angles of somebody upright with joints turned about another one."""
    body = UPRIGHT.copy()
    body[joints] = turned(body[joints] - body[about], np.radians(angle_deg), axis) + body[about]
    body = turned(body, 0.7, 2) + [3.0, -1.0, 0.0]  # where somebody stands is all one
    return {n: float(a[0]) for n, a in joint_angles(body[None], COCO17).items()}


def test_upright_is_zero() -> None:
    for name, angle in moved([], 0, 0, 0).items():
        if "plane" in name:
            assert np.isnan(angle), name  # of an arm that hangs
        else:
            assert angle == pytest.approx(0.0, abs=1e-5), name


@each_case(
    ("joints", "about", "degrees", "axis", "name", "found"),
    [
        ([15], 13, 60, 1, "left_knee_flexion_deg", 60),
        ([10], 8, -90, 1, "right_elbow_flexion_deg", 90),
        ([13, 15], 11, -30, 1, "left_thigh_trunk_flexion_deg", 30),
        ([14, 16], 12, 20, 1, "right_thigh_trunk_flexion_deg", -20),
        ([13, 15], 11, 25, 0, "left_thigh_trunk_abduction_deg", 25),
        ([14, 16], 12, -25, 0, "right_thigh_trunk_abduction_deg", 25),
        ([7, 9], 5, 90, 0, "left_shoulder_elevation_deg", 90),
        ([7, 9], 5, 90, 0, "left_shoulder_plane_deg", 0),
        ([8, 10], 6, -70, 1, "right_shoulder_elevation_deg", 70),
        ([8, 10], 6, -70, 1, "right_shoulder_plane_deg", 90),
    ],
)
def test_one_joint_is_bent(
    joints: list[int], about: int, degrees: float, axis: int, name: str, found: float
) -> None:
    angles = moved(joints, about, degrees, axis)
    assert angles[name] == pytest.approx(found, abs=1e-4)
    others = {n: a for n, a in angles.items() if n.split("_")[1] != name.split("_")[1]}
    assert max(abs(a) for n, a in others.items() if not np.isnan(a)) < 1e-4


def test_trunk_leans_and_twists() -> None:
    upper = [*range(11)]
    body = UPRIGHT.copy()
    body[upper] = turned(body[upper] - [0, 0, 0.92], np.radians(20), 1) + [0, 0, 0.92]
    angles = joint_angles(body[None], COCO17)
    assert float(angles["trunk_lean_forward_deg"][0]) == pytest.approx(20)
    assert float(angles["trunk_lean_deg"][0]) == pytest.approx(20)
    assert float(angles["trunk_lean_left_deg"][0]) == pytest.approx(0, abs=1e-6)
    body = UPRIGHT.copy()
    body[upper] = turned(body[upper], np.radians(15), 2)
    unseen = np.full_like(body, np.nan)
    twist = joint_angles(np.stack([unseen, body]), COCO17)["trunk_twist_left_deg"]
    assert np.isnan(twist[0]) and float(twist[1]) == pytest.approx(15)  # a gap hides no later frame


def test_missing_joints_have_no_angle_and_other_skeletons_what_they_can() -> None:
    body = UPRIGHT.copy()
    body[13] = np.nan
    angles = joint_angles(body[None], COCO17)
    assert np.isnan(angles["left_knee_flexion_deg"][0])
    assert np.isfinite(angles["right_knee_flexion_deg"][0])
    assert "left_knee_flexion_deg" in joint_angles(np.ones((2, 14, 3)), SHELF14)
