"""What all tests need of the process they run in."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings
from tests.postgres import WAY_OUT, Server, programs, running_server

# The same examples in every run. Others are found, and worth looking for, with
# pytest --hypothesis-profile=default
settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")

# Started in the background of a shell, a process ignores Ctrl-C, and so would all that it starts:
# tests that interrupt a program would wait for it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

COMPILED = "e3pose/compiled"  # key in pytest's cache

# The loop of either estimator, over a few slots.
COMPILE = """
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate
recording = simulate(SceneSettings(people=2, seconds=0.5, cameras=3), 0)
for name in ("default", "paper"):
    list(replay(recording, ReplaySettings(pipeline=name, num_selected=3)))
"""


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before workers start, who would each compile all of them."""
    config = session.config
    if not config.getoption("numprocesses", None) or hasattr(config, "workerinput"):
        return
    from e3pose.runtime.kernel import PREDICTOR_SOURCES, SELECTION_SOURCES, sources_stamp

    stamp = sources_stamp((*SELECTION_SOURCES, *PREDICTOR_SOURCES))
    cache = getattr(config, "cache", None)
    if cache is not None and cache.get(COMPILED, None) == stamp:
        return
    subprocess.run([sys.executable, "-c", COMPILE], check=True)
    if cache is not None:
        cache.set(COMPILED, stamp)


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """A PostgreSQL server of this worker of pytest."""
    tools = programs()
    if tools is None:
        pytest.skip(WAY_OUT)
    with running_server(tools) as server:
        yield server


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_disks() -> Iterator[None]:
    """Skip `fsync`: tests read what was written, and none cuts the power."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda handle: None)
        yield
