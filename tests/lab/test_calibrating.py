"""`e3pose calibrate` as a user runs it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.model.noises import load_noise_file
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "recording"
    save_recording(simulate(SceneSettings(people=2, seconds=4.0, cameras=4), seed=5), path)
    return path


def test_noise_is_measured_written_drawn_and_used(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "noise.toml", tmp_path / "noise.svg"
    tokens = ("calibrate", "noise", folder, "--out", out, "--plot", plot, "--detector", "mine")
    assert run(*tokens) == 0
    printed = capsys.readouterr().out
    assert "mine: errors by score, images of 1032 px" in printed
    assert all(f"cam{camera}" in printed for camera in range(4))
    file = load_noise_file(out)
    assert (file.detector, file.basis, file.image_px) == ("mine", "measured", 1032.0)
    assert len(file.views) == 4
    assert sum(file.counts) == sum(view.keypoints for view in file.views.values())
    assert "shipped for simulated" in plot.read_text()
    used = ("replay", folder, "--pipeline", "memory", "--policy", "all", "--noise", out)
    assert run(*used) == 0
    out.write_text(out.read_text().replace("e3pose-noise", "e3pose-news"))
    assert run(*used) == 2
    assert "noise.toml: format: found 'e3pose-news'" in capsys.readouterr().err
