"""Programs end cleanly on one signal, also where it comes twice, and at once on a later one."""

from __future__ import annotations

import os
import signal
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
    assert run_until_stopped(lambda: True, 0.01) == number.name
    signal.raise_signal(number)  # KeyboardInterrupt or SystemExit without the handler
    assert not ended
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + SAME_S + 0.1)
    signal.raise_signal(number)
    assert ended == [128 + number]


def test_program_that_ends_by_itself_gives_signals_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    assert run_until_stopped(lambda: False) == "ended"
    assert signal.getsignal(signal.SIGINT) is before
