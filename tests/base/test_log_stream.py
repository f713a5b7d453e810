"""Output of programs that run for months: whatever becomes of it, nothing waits or fails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from tests.waiting import eventually

from e3pose.base import log_stream
from e3pose.base.log_stream import LogStream

READ, WRITE = 0, 1


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """A disk that is full while this is set."""
    at_work, write = threading.Event(), os.write

    def put(handle: int, content: bytes) -> int:
        if at_work.is_set():
            raise OSError(28, "No space left on device")
        return write(handle, content)

    monkeypatch.setattr(os, "write", put)
    return at_work


def test_lines_that_a_full_disk_drops_are_counted_once_there_is_room(
    tmp_path: Path, full: threading.Event
) -> None:
    log = tmp_path / "log"
    with log.open("wb") as file:
        stream = LogStream(file.fileno())
        print("first", file=stream, flush=True)
        stream.drain()
        full.set()
        for number in range(5):
            print("lost", number, file=stream, flush=True)
        stream.drain()
        full.clear()
        print("last", file=stream)
        print("after", file=stream)
        stream.drain()
    said = "5 lines of this log dropped: no space left on device"
    assert log.read_text().splitlines() == ["first", said, "last", "after"]


def test_count_among_json_is_json(tmp_path: Path, full: threading.Event) -> None:
    log = tmp_path / "log"
    with log.open("wb") as file:
        stream = LogStream(file.fileno())
        stream.as_json = True
        full.set()
        print("{}", file=stream)
        stream.drain()
        full.clear()
        print("{}", file=stream)
        stream.drain()
    first, second = (json.loads(line) for line in log.read_text().splitlines())
    assert "1 line of this log dropped" in first["event"] and second == {}


def test_reader_that_reads_nothing_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_stream, "QUEUE", 50)
    ends = os.pipe()
    stream = LogStream(ends[WRITE])
    for _ in range(1500):
        print("x" * 4096, file=stream, flush=True)  # in all far more than a pipe holds
    os.set_blocking(ends[READ], False)
    got = b""

    def emptied() -> bool:
        nonlocal got
        try:
            got += os.read(ends[READ], 2**16)
        except BlockingIOError:
            return not (stream._parts or stream._writing)
        return False

    assert eventually(emptied)
    print("now", file=stream)
    stream.drain()
    got += os.read(ends[READ], 2**16)
    *lines, last = got.decode().splitlines()
    notes = [line for line in lines if line.endswith(f"dropped: {log_stream.SLOW}")]
    assert last == "now" and notes
    dropped = sum(int(note.split()[0]) for note in notes)
    assert len(lines) - len(notes) + dropped == 1500
    for end in ends:
        os.close(end)


def test_reader_that_went_away_is_no_error() -> None:
    ends = os.pipe()
    os.close(ends[READ])
    stream = LogStream(ends[WRITE])
    print("nobody", file=stream, flush=True)
    stream.drain()
    assert not (stream._parts or stream._writing)
    os.close(ends[WRITE])


PROGRAM = """
import sys, threading
from e3pose.base.log_stream import outlast
outlast()
for number in range(2000):
    print("line", number)
print("said", file=sys.stderr)
def fails():
    raise ValueError("of a thread")
thread = threading.Thread(target=fails)
thread.start()
thread.join()
raise RuntimeError("of the program")
"""


def test_all_that_a_program_says_is_written_before_it_ends(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as log:
        ended = subprocess.run([sys.executable, "-c", PROGRAM], stdout=log, stderr=log)
    said = (tmp_path / "log").read_text()
    assert ended.returncode == 1 and said.count("line ") >= 2000
    assert "ValueError: of a thread" in said and "RuntimeError: of the program" in said


def test_file_that_may_grow_no_more_changes_nothing_for_its_program(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="no limits of processes here")

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    program = PROGRAM.replace("raise RuntimeError", "print")
    with (tmp_path / "log").open("wb") as log:
        ended = subprocess.run(
            [sys.executable, "-c", program], stdout=log, stderr=log, preexec_fn=small
        )
    assert ended.returncode == 0 and (tmp_path / "log").stat().st_size == 4096
