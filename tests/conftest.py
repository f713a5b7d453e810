"""What all tests need of the process they run in."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, settings
from tests.postgres import WAY_OUT, Server, programs, running_server

# Matrices are small: several threads for each cost twice the time of the cores, and five times
# beside other programs. For this process, if it was not started so, and all that it starts.
ASKED = os.environ.get("OPENBLAS_NUM_THREADS") == "1"
assert ASKED or "numpy" not in sys.modules, "numpy was imported before its threads were limited"
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

# As commands have it: looking for garbage less often takes half the time, a fiftieth of most tests.
gc.set_threshold(20_000)

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


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Hide from the garbage collector what stays: thousands of tests, and all modules."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """A PostgreSQL server of this worker of pytest."""
    tools = programs()
    if tools is None:
        pytest.skip(WAY_OUT)
    with running_server(tools) as server:
        yield server


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings and networks, for the tests that are marked so."""
    folder = os.environ.get("E3POSE_SHARED")
    if not folder:
        pytest.skip("E3POSE_SHARED is not set")
    return Path(folder)


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_disks() -> Iterator[None]:
    """Skip `fsync`: tests read what was written, and none cuts the power."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def no_trial_of_networks() -> Iterator[None]:
    """Load networks at once: those of tests are ours, and a process for each takes a second."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("e3pose.detectors.inference._check_bounds", lambda path: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def authorities_once() -> Iterator[None]:
    """Read the system's list of authorities once: a client does so for itself, in 40 ms of CPU."""
    with pytest.MonkeyPatch.context() as patched:
        made = cache(httpx.create_ssl_context)
        patched.setattr("httpx._transports.default.create_ssl_context", made)
        yield
