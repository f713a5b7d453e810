"""`e3pose demo` from the command line, on a machine that reaches nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.site.left_by_demo import canned

from e3pose.cli.app import main
from e3pose.simulate import DetectorSettings, SceneSettings

pytestmark = pytest.mark.slow


def run(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(["demo", *words])
    return ended.value.code


@pytest.fixture
def unreachable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    small = SceneSettings(
        people=1, seconds=1.2, fps=10, cameras=3, detector=DetectorSettings(perfect=True)
    )
    monkeypatch.setattr("e3pose.site.demo.job.STAND_IN", small)
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("E3POSE_OFFLINE", "1")
    monkeypatch.setattr("e3pose.site.demo.live.run_live", canned)
    return tmp_path / "demo"


def test_offline_by_environment_leaves_a_folder(
    unreachable: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not run(str(unreachable))
    out, err = capsys.readouterr()
    assert "Could not download the four-camera recording" in out
    assert f"{unreachable / 'report.html'}: open this first" in out
    assert err.splitlines() == [
        "simulating a scene ...",
        "running the edge and the cameras ...",
        "writing the results ...",
    ]
    assert (unreachable / "report.html").is_file()


def test_taken_destination_is_one_line_and_code_2(
    unreachable: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unreachable.mkdir()
    (unreachable / "mine.txt").write_text("mine")
    for words in ([], ["--overwrite"]):
        assert run(str(unreachable), *words) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.startswith(f"e3pose: {unreachable}:") and err.count("\n") == 1
    assert [path.name for path in unreachable.iterdir()] == ["mine.txt"]


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    assert not run("--help")
    out = capsys.readouterr().out
    assert "e3pose demo" in out and "--offline" in out and "simulated" in out
