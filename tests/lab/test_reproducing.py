"""`e3pose reproduce`: what it says of wrong input, and what it skips."""

from __future__ import annotations

from pathlib import Path

import pytest

from e3pose.cli import main


def failure(capsys: pytest.CaptureFixture[str], *tokens: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(["reproduce", *tokens])
    assert stopped.value.code == 2
    return capsys.readouterr().err


def test_without_data_items_are_skipped_with_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("E3POSE_DATA", raising=False)
    with pytest.raises(SystemExit) as stopped:
        main(["reproduce", str(tmp_path / "out"), "--quick", "--only", "table-1"])
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    assert "Skipped Accuracy on Shelf: no data; expected Shelf with OpenPose detections" in said
    assert (tmp_path / "out" / "report.html").exists()


def test_wrong_input_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    assert "--only: found 'table-9', expected" in failure(capsys, out, "--only", "table-9")
    assert "--data: found" in failure(capsys, out, "--data", str(tmp_path / "none"))
    assert "--seeds: found 0, expected at least 1" in failure(capsys, out, "--seeds", "0")
    assert "--jobs: found 0" in failure(capsys, out, "--jobs", "0")
    assert not (tmp_path / "out").exists()
