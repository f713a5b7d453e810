"""One site of real processes for all tests of its bad days."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, COMPILE_S, LiveSite, eventually, make_keys, make_recording


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("live") / "recording")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    make_keys(folder / "keys")
    made = LiveSite(folder, more=('state = "state.npz"',), tables=("[store]", 'path = "poses.db"'))
    made.write()
    made.start_edge()
    for camera_id in CAMERAS:
        made.start_camera(camera_id)
    made.watch()
    try:
        assert eventually(lambda: len(made.poses) > 20, COMPILE_S), made.told()
        made.becomes(*CAMERAS)
        yield made
        for log in folder.glob("*.log"):
            assert "Traceback" not in log.read_text(), log.read_text()[-3000:]
    finally:
        made.close()
