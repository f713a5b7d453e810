"""Threads are shown by name to the system's tools, and nothing fails where they cannot be."""

from __future__ import annotations

import sys
import threading
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
