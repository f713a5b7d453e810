"""Threads are shown by name to the system's tools, and share work in its order."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from e3pose.base import threads


@pytest.mark.skipif(sys.platform != "linux", reason="Linux shows the names of threads in /proc")
def test_a_thread_is_shown_by_its_name() -> None:
    shown: list[str] = []

    def work() -> None:
        threads.show_thread_name()
        number = threading.current_thread().native_id
        shown.append(Path(f"/proc/self/task/{number}/comm").read_text().strip())

    thread = threading.Thread(target=work, name="keeping-a-very-long-name")
    thread.start()
    thread.join()
    assert shown == ["keeping-a-very-"]


def test_where_there_is_no_such_file_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "Path", lambda name: Path("/nowhere") / name.lstrip("/"))
    threads.show_thread_name()


def test_shared_work_is_given_in_order_and_as_soon_as_it_is_done() -> None:
    taken, hold = list[int](), threading.Event()

    def work(number: int) -> int:
        assert number != 1 or hold.wait(20)
        return 10 * number

    def numbers() -> Iterator[int]:
        for number in range(20):
            taken.append(number)
            if number == 1:  # the first is done, and the thread has said so
                time.sleep(0.2)
            yield number

    found = threads.in_order(work, numbers(), 3)
    assert next(found) == 0 and len(taken) <= 2
    hold.set()
    assert [*found] == [10 * number for number in range(1, 20)]


def test_nothing_more_is_begun_once_nobody_waits() -> None:
    begun: list[int] = []
    found = threads.in_order(begun.append, range(1000), 2)
    next(found)
    del found
    assert len(begun) < 10
