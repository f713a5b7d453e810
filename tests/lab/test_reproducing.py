"""`e3pose reproduce`: what it skips."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.commands import run


def test_without_data_items_are_skipped_with_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("E3POSE_DATA", raising=False)
    assert run("reproduce", tmp_path / "out", "--quick", "--only", "table-1") == 0
    said = capsys.readouterr().out
    assert "Skipped Accuracy on Shelf: no data; expected Shelf with OpenPose detections" in said
    assert (tmp_path / "out" / "report.html").exists()
