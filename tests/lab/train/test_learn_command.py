"""`e3pose learn`: runs without torch, lists versions, goes back."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from e3pose.base.errors import InputError
from e3pose.base.installing import install_command
from e3pose.edge.learn.versions import Version, VersionStore
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.cli.learning import TrainingOptions, learn_replay, list_versions, rollback


def filled(folder: Path) -> Path:
    store = VersionStore(folder / "versions")
    for number in (1, 2):
        version = Version(0, number - 1, 1.8e9, "", (1, 5), (0.011, 0.022), (0.0333, 0.0444), 300)
        store.add(f"weights {number}".encode(), "# Card\n", version)
    return folder


def test_versions_are_listed_with_their_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    list_versions(filled(tmp_path))
    text = capsys.readouterr().out
    heading, *lines = (line.split() for line in text.splitlines())
    rows = {line[0]: " ".join(line) for line in lines[:3]}
    assert set(rows) == {"0", "1", "2"} and " ".join(heading[:2]) == "version parent"
    assert rows["2"].startswith("2 * 1 2027-") and "44.4 -> 22.0" in rows["2"]
    assert "*" not in rows["1"] and "lead 5, mm" in text


def test_one_goes_back_by_one_or_to_a_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rollback(filled(tmp_path))
    assert "version 1 is now current" in capsys.readouterr().out
    rollback(tmp_path, to=0)
    rollback(tmp_path, to=2)
    assert VersionStore(tmp_path / "versions").read().current == 2
    with pytest.raises(InputError, match="version: found 9"):
        rollback(tmp_path, to=9)


def test_a_folder_without_versions_is_named(tmp_path: Path) -> None:
    for call in (list_versions, rollback):
        with pytest.raises(InputError, match="found no versions, expected"):
            call(tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()


@pytest.mark.skipif(importlib.util.find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_the_system_runs_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = simulate(SceneSettings(people=2, seconds=6.0, fps=10.0, cameras=3), seed=4)
    save_recording(recording, tmp_path / "recording")
    learn_replay(
        [tmp_path / "recording"],
        out=tmp_path / "out",
        training=TrainingOptions(held_back=1.0, least=2.0, minutes=0.1),
    )
    said = capsys.readouterr().out
    assert "recording: 60 slots with version 0" in said
    assert "torch is not installed" in said and install_command("train") in said


def test_recordings_must_fit_together(tmp_path: Path) -> None:
    for name, fps in (("slow", 10.0), ("fast", 20.0)):
        settings = SceneSettings(people=1, seconds=1.0, fps=fps, cameras=2)
        save_recording(simulate(settings, seed=0), tmp_path / name)
    with pytest.raises(InputError, match="several skeletons or rates"):
        learn_replay([tmp_path / "slow", tmp_path / "fast"], out=tmp_path / "out")
