"""Markers, set-ups and angles for OpenSim: by their own geometry, and as OpenSim reads them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import BODY
from tests.output.exports.takes import FPS, STARTED_NS, take, turned, walking

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import BODY25, COCO17, HALPE26
from e3pose.model.take import MISSING, Motion, Take, motions_of
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.opensim.markers import columns
from e3pose.output.exports.opensim.model import bodies
from e3pose.output.exports.opensim.mot import coordinates

OPENSIM = "opensim==4.6"
INSTALL_S, RUN_S = 180, 120
READER = Path(__file__).with_name("opensim_reads.py")

UPRIGHT = BODY.copy()  # faces x, y to the left; arms and legs hang
for _side in (0, 1):
    UPRIGHT[[7 + _side, 9 + _side]] = UPRIGHT[5 + _side] - [[0, 0, 0.3], [0, 0, 0.6]]
    UPRIGHT[[13 + _side, 15 + _side]] = UPRIGHT[11 + _side] - [[0, 0, 0.42], [0, 0, 0.84]]


def angles(body: np.ndarray) -> dict[str, float]:
    return {name: float(a[0]) for name, a in coordinates(body[None], COCO17).items()}


def test_upright_is_zero_and_the_pelvis_is_between_the_hips() -> None:
    middle = UPRIGHT[[11, 12]].mean(axis=0)
    for name, value in angles(UPRIGHT).items():
        if name.startswith("pelvis_t") and name[-1] in "xyz":
            assert value == pytest.approx(
                {"x": middle[0], "y": middle[2], "z": -middle[1]}[name[-1]]
            )
        else:
            assert value == pytest.approx(0.0, abs=1e-4), name


@each_case(
    ("joints", "about", "degrees", "axis", "name", "found"),
    [
        ([13, 15], 11, -30, 1, "hip_flexion_l", 30),
        ([14, 16], 12, 20, 1, "hip_flexion_r", -20),
        ([13, 15], 11, 25, 0, "hip_adduction_l", -25),
        ([14, 16], 12, -25, 0, "hip_adduction_r", -25),
        ([15], 13, 60, 1, "knee_angle_l", 60),
        ([16], 14, 60, 1, "knee_angle_r", 60),
        ([7, 9], 5, -40, 1, "arm_flex_l", 40),
        ([8, 10], 6, -40, 1, "arm_flex_r", 40),
        ([7, 9], 5, 50, 0, "arm_add_l", -50),
        ([8, 10], 6, -50, 0, "arm_add_r", -50),
        ([9], 7, -90, 1, "elbow_flex_l", 90),
        ([10], 8, -90, 1, "elbow_flex_r", 90),
    ],
)
def test_one_joint_is_bent_as_opensim_counts_it(
    joints: list[int], about: int, degrees: float, axis: int, name: str, found: float
) -> None:
    body = UPRIGHT.copy()
    body[joints] = turned(body[joints] - body[about], np.radians(degrees), axis) + body[about]
    result = angles(body)
    assert result[name] == pytest.approx(found, abs=1e-4)
    others = {n: v for n, v in result.items() if n != name and n[:8] != "pelvis_t"}
    assert max(map(abs, others.values())) < 1e-4, others


def test_markers_have_the_names_of_the_other_tools() -> None:
    known = dict(columns(HALPE26, "pose2sim"))
    assert {"Hip", "RHip", "LBigToe", "RSmallToe", "RHeel", "Neck", "Head", "Nose"} <= set(known)
    assert len(known) == len(HALPE26)
    known = dict(columns(BODY25, "opencap"))
    assert {"midHip", "Neck", "LWrist", "REar"} <= set(known) and len(known) == len(BODY25)
    added = dict(columns(COCO17, "opencap"))
    assert added["midHip"] == (11, 12) and added["Neck"] == (5, 6)
    assert dict(columns(COCO17, None))["left_hip"] == (11,)


def test_the_model_weighs_a_whole_person_and_its_joints_hang_together() -> None:
    names = ["ground"]
    for body in bodies():
        assert body.parent in names
        names.append(body.name)
    assert sum(body.mass for body in bodies()) == pytest.approx(1.0)


def with_gap(motion: Motion, frames: slice, joints: list[int] | slice) -> Motion:
    joints_m, origin = motion.joints_m.copy(), motion.origin.copy()
    joints_m[frames, joints], origin[frames, joints] = np.nan, MISSING
    return replace(motion, joints_m=joints_m, origin=origin)


def test_each_tool_gets_the_longest_time_that_it_can_use(tmp_path: Path) -> None:
    (motion,) = take().motions[1:]  # from frame 6
    motion = with_gap(with_gap(motion, slice(8, 9), [16]), slice(30, 31), slice(None))
    one = Take("w", COCO17, 1 / FPS, (motion,))
    ((_, note),) = export(one, tmp_path / "w.trc", "trc", ExportSettings(names="pose2sim"))
    assert note.endswith("beside it w-model.osim, w-markers.xml, w-scale.xml, w-ik.xml")
    times = {}
    for tool in ("scale", "ik"):
        node = xml.parse(tmp_path / f"w-{tool}.xml").find(".//time_range")
        assert node is not None and node.text is not None
        times[tool] = [round(float(word) * FPS) for word in node.text.split()]
    assert times == {"scale": [15, 35], "ik": [6, 35]}
    never = with_gap(motion, slice(None), [15])
    one = replace(one, motions=(never,))
    ((_, note),) = export(one, tmp_path / "n.trc", "trc", ExportSettings(names="pose2sim"))
    assert "no frame has all markers" in note and "--fill" in note


def test_a_motion_keeps_what_a_frame_does_not_tell_and_says_so(tmp_path: Path) -> None:
    one = replace(take(), motions=(with_gap(take().motions[1], slice(5, 8), [14]),))
    ((path, note),) = export(one, tmp_path / "w.mot", "mot")
    assert "25 coordinates" in note and "values are those of an earlier frame" in note
    lines = path.read_text().splitlines()
    assert lines[2:7] == ["nRows=34", "nColumns=26", "inDegrees=yes", "endheader", lines[6]]
    names = lines[6].split("\t")
    rows = np.array([[float(cell) for cell in line.split("\t")] for line in lines[7:]])
    assert rows.shape == (34, 26) and np.isfinite(rows).all() and rows[0, 0] == 6 / FPS
    assert (rows[5:8, names.index("knee_angle_r")] == rows[4, names.index("knee_angle_r")]).all()


def test_a_motion_needs_hips_and_shoulders(tmp_path: Path) -> None:
    nobody = replace(take(), motions=(with_gap(take().motions[1], slice(None), [5]),))
    with pytest.raises(InputError, match="track7: found no frame with hips and shoulders"):
        list(export(nobody, tmp_path / "w.mot", "mot"))
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("opensim")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(folder)]
    try:
        done = subprocess.run([*command, OPENSIM], capture_output=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip("no package index answers pip")
    if done.returncode:
        pytest.skip("no package index has OpenSim for this Python")
    return folder


@pytest.mark.network
@pytest.mark.nightly  # installs OpenSim
@pytest.mark.parametrize("names", ["pose2sim", "opencap"])
def test_opensim_scales_a_model_and_finds_it(packages: Path, tmp_path: Path, names: str) -> None:
    joints_m = walking()
    ids, sigma_m = np.full(len(joints_m), 4), np.full(joints_m.shape[:2], 0.01)
    (walk,) = motions_of(np.arange(len(joints_m)), People(ids, joints_m, sigma_m=sigma_m))
    walk = with_gap(walk, slice(10, 13), [16])  # the last marker of rows, which it must read
    one = Take("walk", COCO17, 1 / FPS, (walk,), STARTED_NS)
    list(export(one, tmp_path / "walk.trc", "trc", ExportSettings(names=names)))
    list(export(one, tmp_path / "walk.mot", "mot"))
    done = subprocess.run(
        [sys.executable, str(READER), str(tmp_path / "walk")],
        capture_output=True,
        text=True,
        timeout=RUN_S,
        env={**os.environ, "PYTHONPATH": str(packages)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["scaled"] and said["solved"]
    assert said["mass_kg"] == pytest.approx(70.0)
    assert set(said["markers"]) == {name for name, _ in columns(COCO17, names)}
    assert said["ik_mm"] < 15, said
    assert said["mot_mm"] < 15, said
