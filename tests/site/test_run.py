"""Programs end cleanly on one signal, also where it comes twice, and at once on a later one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from e3pose.site.run import SAME_S, run_until_stopped


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_second_signal_does_not_break_into_a_clean_end(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[int] = []
    monkeypatch.setattr(os, "_exit", ended.append)
    threading.Timer(0.05, lambda: os.kill(os.getpid(), number)).start()
    assert run_until_stopped(lambda: True, every_s=0.01) == number.name
    signal.raise_signal(number)  # KeyboardInterrupt or SystemExit without the handler
    assert not ended
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + SAME_S + 0.1)
    signal.raise_signal(number)
    assert ended == [128 + number]


def test_program_that_ends_by_itself_gives_signals_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    assert run_until_stopped(lambda: False) == "ended"
    assert run_until_stopped(lambda: True, for_s=0.02, every_s=0.01) == "ended"
    assert signal.getsignal(signal.SIGINT) is before


# Says how it ended; `HELD` decides whether it does so in time.
CHILD = """
import signal, sys, time
from e3pose.site.run import end_with_parent
def end(*_):
    time.sleep(HELD)
    print("ended cleanly", flush=True)
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
end_with_parent(0.2)
print("ready", flush=True)
while True:
    time.sleep(0.01)
"""


@pytest.mark.parametrize(("held", "said", "code"), [(0, "ended cleanly\n", 0), (60, "", 143)])
def test_program_ends_with_its_parent_cleanly_or_soon(held: int, said: str, code: int) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD.replace("HELD", str(held))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdin is not None and child.stdout is not None
    try:
        assert child.stdout.readline() == "ready\n"
        child.stdin.write("words to a program that reads none\n")
        child.stdin.flush()
        assert child.poll() is None
        child.stdin.close()  # as the system does for a parent that was killed
        assert child.wait(30) == code
        assert child.stdout.read() == said
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
