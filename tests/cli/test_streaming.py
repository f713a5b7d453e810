"""`e3pose stream` where no edge runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.cli import commands
from tests.ports import free_port

from e3pose.base.errors import Exit
from e3pose.cli import streaming
from e3pose.recording import load_recording
from e3pose.site.example import write_recorded


def test_stream_for_some_seconds_ends_where_no_slot_comes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert commands.run("simulate", tmp_path / "scene", "--seconds", "1") == 0
    site = write_recorded(tmp_path / "site", load_recording(tmp_path / "scene"), "lab")
    port = rf"\1:{free_port()}"
    site.write_text(re.sub(r"(tcp/127\.0\.0\.1):\d+", port, site.read_text()))
    monkeypatch.setattr(streaming, "FIRST_SLOT_S", 0.5)
    capsys.readouterr()
    dest = tmp_path / "poses.mcap"
    assert commands.run("stream", site, f"mcap:{dest}", "--for", "3600") == Exit.FAULT
    said = capsys.readouterr().err
    assert "site lab: found no slot in 0.5 s, expected an edge that runs" in said
