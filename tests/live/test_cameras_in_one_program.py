"""All cameras of a machine in one program: one that fails takes none with it."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path

import pytest
from tests.cli.commands import refused
from tests.live.processes import CAMERAS, COMPILE_S, LiveSite, e3pose, make_keys, run
from tests.waiting import eventually


def test_camera_that_fails_takes_none_with_it_and_comes_back(
    tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "recording").symlink_to(recording)
    sources = {**dict.fromkeys(CAMERAS, "recorded:recording"), "cam2": "recorded:later"}
    tables = [f'[[camera]]\nid = "{name}"\nsource = "{seen}"' for name, seen in sources.items()]
    site = LiveSite(tmp_path, tables=tables)
    make_keys(site.folder / "keys")
    site.write()
    try:
        site.start_edge()
        site.start("cameras", *e3pose("cameras", str(site.path)))
        site.watch()
        assert eventually(lambda: len(site.poses) > 20, COMPILE_S), site.diagnostics()
        site.becomes("cam0", "cam1")
        assert "later: no such folder" in site.log("cameras").read_text(), site.diagnostics()
        assert "the camera starts again in 2 s" in site.log("cameras").read_text()

        slots = len(site.poses)
        shutil.copytree(recording, tmp_path / "later")
        site.becomes(*CAMERAS)
        assert len(site.poses) > slots  # the others went on meanwhile
        site.send("cameras", signal.SIGTERM)
        assert site.wait("cameras") == 0, site.diagnostics()
        said = site.log("cameras").read_text()
        assert all(f"{name}: " in said.splitlines()[-3 + at] for at, name in enumerate(CAMERAS))
        assert "Traceback" not in said
    finally:
        site.close()


def test_program_without_any_camera_that_starts_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = []
    for name in ("cam0", "cam1"):
        files.append(tmp_path / f"{name}.toml")
        files[-1].write_text(
            f'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "{name}"\n'
            'source = "gone.mp4"\ndetector = "drawn"\nendpoint = "tcp/127.0.0.1:7001"\n'
        )
    code, _, err = run("cameras", *map(str, files))
    assert code == 2 and "gone.mp4" in err.splitlines()[-1], err
    files[1].write_text(files[0].read_text())
    assert "cameras: found cam0 twice, expected each once" in refused(capsys, "cameras", *files)
    only = ("cameras", files[0], "--only", "cam7")
    assert "--only: found cam7, expected names of cam0" in refused(capsys, *only)
