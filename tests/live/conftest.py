"""One site of real processes for all tests of faults."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import LiveSite, make_recording


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("live") / "recording")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    made = LiveSite(folder, more=('state = "state.npz"',), tables=("[store]", 'path = "poses.db"'))
    with made.at_work():
        yield made
