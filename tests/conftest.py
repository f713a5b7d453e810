"""What all tests need of the process they run in."""

from __future__ import annotations

import fcntl
import gc
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from tests.postgres import WAY_OUT, Server, programs, running_server

# Matrices are small: several threads for each cost twice the time of the cores. For this process,
# which has not imported numpy yet, and all that it starts.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

# The same examples in every run; a busy machine takes long for each. Others are found, and worth
# looking for, with pytest --hypothesis-profile=search
BUSY = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("search", BUSY)
settings.register_profile("fixed", BUSY, derandomize=True)
settings.load_profile("fixed")

# Started in the background of a shell, a process ignores Ctrl-C, and so would all that it starts:
# tests that interrupt a program would wait for it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A command that would take all cores works in the process of its test: processes of its own take
# seconds to start, beside tests that have the cores. A number of processes that is given counts.
os.environ["LOKY_MAX_CPU_COUNT"] = "1"

COMPILED = "e3pose/compiled"  # key in pytest's cache

# The loop of an estimator, over a few slots.
COMPILE = """
import sys
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate
recording = simulate(SceneSettings(people=2, seconds=0.5, cameras=3), 0)
for policy in ("information", "independent"):  # these two use all kernels of selection
    list(replay(recording, ReplaySettings(pipeline=sys.argv[1], policy=policy, num_selected=3)))
"""

# `make test` looks for these marks in these rooms only.
ROOMS = {"live": {"live"}, "timed": {"live", "edge"}}
# These start first: on a worker of its own at the end, each would keep the whole run waiting.
LONGEST = (
    "live/test_four_cameras.py",
    "live/test_soak.py",
    "test_docs_commands.py",
    "test_distributions.py",
    "wire",
)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before workers start, who would each compile all of them."""
    config = session.config
    if not config.getoption("numprocesses", None) or hasattr(config, "workerinput"):
        return
    from e3pose.base.kernel_cache import stamp_of
    from e3pose.evaluate import replay

    stamp = stamp_of(Path(replay.__file__).resolve())
    cache = getattr(config, "cache", None)
    if cache is None:
        compile_kernels()
        return
    with (cache.mkdir("e3pose") / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # a run beside this one waits, and finds them compiled
        if cache.get(COMPILED, None) != stamp:
            compile_kernels()
            cache.set(COMPILED, stamp)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write down for `make test` which tests needed a second try, and which failed."""
    if hasattr(terminalreporter.config, "workerinput"):
        return
    for variable, outcomes in (("RERUNS", ("rerun",)), ("FAILED", ("failed", "error"))):
        reports = [report for each in outcomes for report in terminalreporter.stats.get(each, ())]
        path = os.environ.get(variable)
        if reports and path:
            with Path(path).open("a") as listed:
                listed.writelines(f"{name}\n" for name in sorted({one.nodeid for one in reports}))


def compile_kernels() -> None:
    """Compile every kernel to disk: the filter, which takes longest, beside most of the others."""
    commands = [[sys.executable, "-c", COMPILE, pipeline] for pipeline in ("default", "paper")]
    for program in [subprocess.Popen(command) for command in commands]:
        if program.wait() != 0:
            raise pytest.UsageError("the kernels do not compile")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Hide from the garbage collector what stays: thousands of tests, and all modules."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest first; refuse a test that `make test` would not run."""
    start = f"{Path(__file__).parent}{os.sep}"
    longest = tuple(f"{start}{name}" for name in LONGEST)
    items.sort(key=lambda item: not str(item.path).startswith(longest))
    for item in items:
        room = str(item.path).removeprefix(start).partition(os.sep)[0]
        for mark, rooms in ROOMS.items():
            if room not in rooms and item.get_closest_marker(mark):
                places = " or ".join(f"tests/{name}" for name in sorted(rooms))
                raise pytest.UsageError(f"{item.nodeid}: marked {mark}, expected in {places}")


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
