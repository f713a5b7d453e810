"""`e3pose simulate` from the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cli import commands

from e3pose.recording import load_recording
from e3pose.simulate import SCENES, SceneSettings, adjusted, simulate


def run(*words: str) -> int:
    return commands.run("simulate", *words)


def test_writes_the_recording_that_the_library_makes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dest = tmp_path / "scene"
    options = ("--scene", "crossing", "--people", "3", "--cameras", "4", "--seconds", "2")
    assert run(str(dest), *options, "--seed", "7", "--resolution", "640x480") == 0
    assert "4 cameras, 50 slots at 25 fps" in capsys.readouterr().out
    loaded = load_recording(dest)
    settings = SceneSettings(
        scene="crossing", people=3, cameras=4, seconds=2, image_size=(640, 480)
    )
    made = simulate(settings, 7)
    assert loaded.truth is not None and made.truth is not None
    assert loaded.truth.person_ids == ("person1", "person2", "person3")
    assert loaded.truth_complete
    assert loaded.rig.cameras[0].image_size == (640, 480)
    np.testing.assert_allclose(loaded.truth.joints_m, made.truth.joints_m, atol=1e-3)
    for got, wanted in zip(loaded.views, made.views, strict=True):
        np.testing.assert_array_equal(got.starts, wanted.starts)
        np.testing.assert_allclose(got.keypoints_px, wanted.keypoints_px, atol=0.1)


def test_exact_recording_projects_after_a_round_trip(tmp_path: Path) -> None:
    assert run(str(tmp_path / "scene"), "--people", "1", "--seconds", "1", "--exact") == 0
    loaded = load_recording(tmp_path / "scene")
    assert loaded.truth is not None
    view = loaded.view(0, 0)
    assert view is not None and len(view) == 1
    pixels = loaded.rig.cameras[0].project(loaded.truth.joints_m[0, 0])
    seen = view.scores[0] == 1
    assert seen.sum() > 8
    np.testing.assert_allclose(view.keypoints_px[0][seen], pixels[seen], atol=0.1)


def test_takes_a_users_rig(tmp_path: Path) -> None:
    assert run(str(tmp_path / "first"), "--cameras", "3", "--seconds", "0.2") == 0
    calibration = tmp_path / "first" / "calibration.toml"
    assert run(str(tmp_path / "second"), "--calibration", str(calibration), "--seconds", "0.2") == 0
    first, second = load_recording(tmp_path / "first"), load_recording(tmp_path / "second")
    assert first.rig.camera_ids == second.rig.camera_ids
    np.testing.assert_allclose(first.rig.centers_m, second.rig.centers_m, atol=1e-6)
    assert run(str(tmp_path / "first"), "--seconds", "0.4") == 2
    assert run(str(tmp_path / "first"), "--seconds", "0.4", "--overwrite") == 0
    assert load_recording(tmp_path / "first").num_slots == 10


def test_errors_and_their_figures_reach_the_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--scene", "buffet", "--seconds", "0.4", "--fps", "5", "--seed", "3")
    for name, more in {
        "own": (),
        "score": ("--errors", "score"),
        "changed": ("--set-error", "lasting=0.1", "--set-error", "ghosts=0"),
    }.items():
        assert run(str(tmp_path / name), *options, *more) == 0
    own, score, changed = (load_recording(tmp_path / n) for n in ("own", "score", "changed"))
    assert (own.detector, score.detector) == ("openpose", "simulated")
    detector = adjusted(SCENES["buffet"].detector, {"lasting": 0.1, "ghosts": 0.0})
    made = simulate(SceneSettings(scene="buffet", seconds=0.4, fps=5, detector=detector), 3)
    for got, wanted in zip(changed.views, made.views, strict=True):
        np.testing.assert_allclose(got.keypoints_px, wanted.keypoints_px, atol=0.1)
    ring = ("--scene", "ring", "--seconds", "0.2", "--errors", "situation")
    assert run(str(tmp_path / "ring"), *ring) == 0
    assert load_recording(tmp_path / "ring").detector == "openpose"
    capsys.readouterr()
    for words, message in (
        (("--set-error", "lasting"), "expected NAME=VALUE such as lasting=0.5"),
        (("--set-error", "kindness=1"), "found 'kindness', expected one of blur"),
        (("--set-error", "lasting=3"), "guessing lasting: found 3, expected a number from 0 to 1"),
        (("--exact", "--errors", "score"), "--exact: found errors beside it"),
    ):
        assert run(str(tmp_path / "bad"), *options, *words) == 2
        assert message in " ".join(capsys.readouterr().err.split())
        assert not (tmp_path / "bad").exists()
