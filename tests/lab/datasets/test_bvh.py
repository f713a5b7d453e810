"""Motion capture in BVH: places by hand, round trips through the exporter, and files refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.events.bodies import FPS, doing
from tests.output.exports.takes import STARTED_NS

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.take import Take, motions_of
from e3pose.output.exports import ExportSettings, export
from e3pose.recording import load_recording
from e3pose_lab.datasets.bvh import import_bvh
from e3pose_lab.datasets.bvh_file import places_of, read_bvh

ARM = """HIERARCHY
ROOT Hips
{
    OFFSET 1 0 0
    CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
    JOINT Chest
    {
        OFFSET 0 2 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        End Site
        {
            OFFSET 0 1 0
        }
    }
}
MOTION
Frames: 2
Frame Time: 0.04
0 0 0 0 0 0 0 0 0
1 0 5 90 0 0 0 90 0
"""


def falling(seconds: float = 12.0) -> Take:
    """Return somebody who falls forward."""
    joints_m = doing("fall-forward", 0, seconds=seconds)
    people = People(np.full(len(joints_m), 1), joints_m, sigma_m=np.full(joints_m.shape[:2], 0.01))
    motions = motions_of(np.arange(len(joints_m)), people)
    return Take("fall", COCO17, 1 / FPS, motions, STARTED_NS)


def written(folder: Path, settings: ExportSettings) -> Path:
    ((path, _),) = export(falling(), folder / "fall.bvh", "bvh", settings)
    return path


def test_joints_are_where_channels_turn_them(tmp_path: Path) -> None:
    (tmp_path / "arm.bvh").write_text(ARM)
    bvh = read_bvh(tmp_path / "arm.bvh")
    assert [node.name for node in bvh.nodes] == ["Hips", "Chest", "Chest end"]
    first, second = places_of(bvh)
    np.testing.assert_allclose(first, [[1, 0, 0], [1, 2, 0], [1, 3, 0]], atol=1e-12)
    # A quarter about z puts the chest to -x; its own quarter about x, turned so, the end to z.
    np.testing.assert_allclose(second, [[2, 0, 5], [0, 0, 5], [0, 0, 6]], atol=1e-12)


@each_case("names", [None, "vrm", "mixamo", "unreal"])
@each_case("units", ["m", "mm"])
def test_what_the_exporter_writes_is_read_back(
    tmp_path: Path, names: str | None, units: Literal["m", "mm"]
) -> None:
    settings = replace(ExportSettings(), names=names, units=units)
    recording, scale_m = import_bvh(written(tmp_path, settings))
    assert scale_m == {"m": 1.0, "mm": 0.001}[units] and recording.fps == FPS
    assert recording.truth is not None and recording.truth.skeleton == COCO17
    found, true = recording.truth.joints_m[:, 0], falling().motions[0].joints_m
    limbs = slice(5, 17)
    shift = np.median((found - true)[:, limbs], axis=(0, 1))
    np.testing.assert_allclose(shift[:2], 0, atol=0.02)  # the floor is where feet are
    off_m = np.linalg.norm(found[:, limbs] - true[:, limbs] - shift, axis=-1)
    assert np.median(off_m) < 0.02 and np.quantile(off_m, 0.95) < 0.06
    assert np.isfinite(found).all(), "the face is made up"
    nose_m, head_m = found[:, 0], found[:, 3:5].mean(axis=1)
    assert np.linalg.norm(nose_m - head_m, axis=-1).max() < 0.2


def test_a_scale_and_an_axis_can_be_named(tmp_path: Path) -> None:
    path = written(tmp_path, replace(ExportSettings(), units="m"))
    tall, scale_m = import_bvh(path, scale_m=1.1)
    usual, _ = import_bvh(path)
    lying, _ = import_bvh(path, z_up=True)
    assert scale_m == 1.1 and tall.truth and usual.truth and lying.truth
    ratio = np.ptp(tall.truth.joints_m[:, 0, 5:, 0]) / np.ptp(usual.truth.joints_m[:, 0, 5:, 0])
    assert ratio == pytest.approx(1.1)
    heights = [np.ptp(one.truth.joints_m[0, 0, 5:, 2]) for one in (usual, lying) if one.truth]
    assert heights[0] > 1.1 and heights[1] < 0.7
    with pytest.raises(InputError, match="--scale METRES-PER-UNIT"):
        import_bvh(path, scale_m=30.0)


@each_case(
    ("old", "new", "said"),
    [
        ("HIERARCHY", "hello", "line 1: found 'hello', expected HIERARCHY"),
        ("MOTION\n", "", "found no line MOTION"),
        ("OFFSET 1 0 0", "OFFSET 1 0", "line 5: found 'CHANNELS', expected a number"),
        ("OFFSET 1 0 0", "OFFSET 1 0 nan", "line 4: found 'nan', expected a number"),
        ("CHANNELS 3 Z", "CHANNELS 9 Z", "line 9: found 9 channels, expected 0 to 6"),
        ("3 Zrotation", "3 Wrotation", "line 9: found 'Wrotation', expected one of X"),
        ("3 Zrotation", "3 Xrotation", "line 9: found a channel twice"),
        ("End Site", "End Sight", "line 10: found 'Sight', expected SITE"),
        ("        }\n    }\n}", "        }\n    }", "found the end of the header, expected }"),
        ("}\nMOTION", "}\nROOT Two\nMOTION", "line 16: found 'ROOT', expected one ROOT"),
        ("Frames: 2", "Frames: 3", "line 17: found 3 frames, and 2 lines of numbers"),
        ("Frames: 2", "Frames: many", "line 17: found 'many', expected a number"),
        ("Frame Time: 0.04", "Frame Time: 0", "line 18: found 0 s per frame"),
        ("Frame Time", "Frametime", "line 18: found 'Frametime: 0.04', expected Frame Time:"),
        ("1 0 5 90 0 0 0 90 0", "1 0 5 90", "line 20: found 4 words, expected 9 numbers"),
        ("1 0 5 90", "1 0 5 inf", "line 20: found a number that is not finite"),
    ],
)  # fmt: skip
def test_a_file_that_is_wrong_is_refused_with_its_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    assert old in ARM
    (tmp_path / "arm.bvh").write_text(ARM.replace(old, new, 1))
    with pytest.raises(InputError) as refused:
        read_bvh(tmp_path / "arm.bvh")
    assert said in str(refused.value), str(refused.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.bvh").write_bytes(b"\xff\xfe\x00MOTION")
    with pytest.raises(InputError, match="found no text"):
        read_bvh(tmp_path / "arm.bvh")


def test_a_tree_without_end_is_refused(tmp_path: Path) -> None:
    deep = "JOINT J\n{\nOFFSET 0 0 0\nCHANNELS 0\n" * 200
    (tmp_path / "deep.bvh").write_text(ARM.replace("JOINT Chest", f"{deep}JOINT Chest"))
    with pytest.raises(InputError, match="at most 1000, 100 deep"):
        read_bvh(tmp_path / "deep.bvh")


def test_what_is_no_person_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.bvh").write_text(ARM)
    with pytest.raises(InputError, match=r"found no left shoulder, left elbow.* among Hips, Chest"):
        import_bvh(tmp_path / "arm.bvh")


def test_the_verb_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, replace(ExportSettings(), units="mm"))
    assert run("import", "bvh", path, tmp_path / "fall") == 0
    assert "Unit of fall.bvh: 0.001 m" in capsys.readouterr().out
    assert load_recording(tmp_path / "fall").truth is not None
    assert run("import", "bvh", path, tmp_path / "fall") == 2, "it is there"
