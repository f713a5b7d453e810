"""A test of notices: the page asks, webhooks on the same machine send one and say how it went.

A stream is a viewer of the site and hears no operator. So the question and the answers are files
beside the site file, in the folder of `stream_problems`:

    test.asked   a random word, new with each question
    PID.answer   that word, then how each webhook fared, a line each
"""

from __future__ import annotations

import os
import secrets
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import make_folder
from e3pose.site.stream_problems import FOLDER, MOST_FILES, MOST_LINES, lines_of

ASKED, ANSWER = "test.asked", ".answer"
WAIT_S = 12.0  # for the first answer: a receiver may take 10 s
MORE_S = 0.5  # for those of other programs
LOOK_S = 0.1
NOBODY = "no webhook is at work on this machine: e3pose stream SITE webhook:https://HOST/PATH"


@runtime_checkable
class CanTest(Protocol):
    """A stream that can send a test notice."""

    def test(self) -> str:
        """Send a test notice once; return how it went, a line. It may take seconds."""
        ...


class Answerer:
    """Answers questions for a test, for the streams of this program."""

    def __init__(self, site: Path, streams: Sequence[object]) -> None:
        """Answer questions that are asked from now on.

        Args:
            site: the site file beside which they are.
            streams: those that can, of the program.
        """
        self._folder = site.parent / FOLDER
        self._streams = [stream for stream in streams if isinstance(stream, CanTest)]
        self._last = _asked(self._folder)
        self._thread: threading.Thread | None = None

    def update(self) -> None:
        """Look for a question; to be called often. A thread answers it."""
        busy = self._thread is not None and self._thread.is_alive()
        if not self._streams or busy or (word := _asked(self._folder)) in ("", self._last):
            return
        self._last = word
        self._thread = threading.Thread(target=self._answer, args=(word,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave no answer behind."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    @property
    def _path(self) -> Path:
        return self._folder / f"{os.getpid()}{ANSWER}"

    def _answer(self, word: str) -> None:
        lines = [word, *(stream.test() for stream in self._streams)]
        with suppress(OSError, InputError):
            write_file(self._path, "\n".join(lines) + "\n", private=True)


def send_test(site: Path, wait_s: float = WAIT_S) -> list[str]:
    """Have a test notice sent; return how each webhook on this machine fared, a line each.

    Args:
        site: the site file.
        wait_s: for the first answer.

    Raises:
        InputError: when no webhook answers, or the question cannot be written.
    """
    folder, word = site.parent / FOLDER, secrets.token_hex(16)
    make_folder(folder)
    try:
        write_file(folder / ASKED, word, private=True)
    except OSError as error:
        raise InputError(f"{folder}: {reason_of(error).lower()}") from None
    until_s = time.monotonic() + wait_s
    found: list[str] = []
    while time.monotonic() < until_s:
        time.sleep(LOOK_S)
        before, found = found, _answers(folder, word)
        if found and not before:
            until_s = min(until_s, time.monotonic() + MORE_S)
    if not found:
        raise InputError(NOBODY)
    return found


def _asked(folder: Path) -> str:
    """Return the word of the newest question; empty without any."""
    with suppress(OSError), (folder / ASKED).open(encoding="utf-8", errors="replace") as file:
        return file.read(64)
    return ""


def _answers(folder: Path, word: str) -> list[str]:
    found: list[str] = []
    for path in sorted(folder.glob(f"*{ANSWER}"))[:MOST_FILES]:
        with suppress(OSError):  # one that cannot be read hides no other
            first, *lines = lines_of(path, 1 + MOST_LINES) or [""]
            if first == word:
                found += lines
    return found
