"""One site of real processes for all tests of its bad days."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import LiveSite, make_recording

SOAK = Path(__file__).parents[2] / "benchmarks" / "soak.py"


@pytest.fixture(scope="session", autouse=True)
def soak(request: pytest.FixtureRequest) -> Iterator[subprocess.Popen[str] | None]:
    """Let the soak run for its minute beside the other tests, if it is to be looked at."""
    if not any("test_soak" in item.nodeid for item in request.session.items):
        yield None
        return
    program = subprocess.Popen(
        [sys.executable, str(SOAK), "--minutes", "1", "--every", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    yield program
    if program.poll() is None:
        program.send_signal(signal.SIGINT)  # it ends its site first
    program.communicate()


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
