"""Errors, and the exit code of each kind."""

from __future__ import annotations

import errno
import re
import signal
from enum import IntEnum
from typing import Any

MISSING = "missing"  # found, where what is expected says what to write
# A file or database that a sentence begins with, and folders in it.
WHERE = re.compile(r"^(?:\S+://\S+|(?:[A-Za-z]:)?[\\/]\S*): ")
FOLDERS = re.compile(r"(?<!\S)(?:[A-Za-z]:)?[\\/](?:[^\s\\/]+[\\/])*")

# Of the system: the machine cannot do what the input asks for, and may be able to later.
MACHINE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EMFILE, errno.ENFILE}
SQLITES = {"disk I/O error", "database or disk is full"}  # for the first four of these


class Exit(IntEnum):
    """The exit codes of all programs; `docs/reference/faults.md` has them for people."""

    DONE = 0  # the work is done, or a program that runs on was told to end
    NO = 1  # the work is done, and its answer is no: problems found, something is left
    REFUSED = 2  # input, options or the installation are wrong: a restart does not help
    NOBODY = 3  # the work is done and found no person; it says why
    FAULT = 4  # it failed while it ran: a restart may help
    GAVE_UP = 5  # a program that it starts ended again and again
    SIGNAL = 128  # and the number of the signal that ended it before its work was done


class Fault(Exception):
    """A program failed while it ran; its cause says why. The command line exits with its code."""

    code = Exit.FAULT


class GaveUp(Fault):
    """A program that was started again and again never worked."""

    code = Exit.GAVE_UP


class InputError(ValueError):
    """A file, option or message differs from what is expected of it.

    Its text is one line a user can act on: `site.toml: loop.cameras: found 99, expected ...`. The
    command line prints it and exits with code 2. Whoever finds the fault knows what was found and
    what was expected; whoever knows where that was written adds it on the way out, with `at`.

    Attributes:
        place: the file, or empty.
        thing: what is wrong: a key, an option, a camera; or empty.
        found: what it was, in words; None in an error that is all one sentence.
        expected: what it should have been, likewise.
    """

    def __init__(
        self, thing: str, found: object = None, expected: str | None = None, place: str = ""
    ) -> None:
        """Take a message that names the fault.

        Args:
            thing: what is wrong; or, alone, the whole sentence.
            found: what it was.
            expected: what it should have been.
            place: the file.
        """
        super().__init__(thing, found, expected, place)
        self.sentence = thing if found is None and expected is None else ""
        self.thing = "" if self.sentence else thing
        self.found = None if found is None else str(found)
        self.expected, self.place = expected, place

    def at(self, place: object = "", thing: str | None = None) -> InputError:
        """Return the error with the place where it was written.

        Args:
            place: the file; the one that is known stays, as it is nearer to the fault, and so does
                the one that a sentence begins with.
            thing: what the thing is called there, such as `loop.cameras` or `--cameras`.
        """
        place = self.place or str(place)
        if self.sentence:
            place = "" if self.sentence.startswith(f"{place}: ") else place
            named = f"{thing}: {self.sentence}" if thing else self.sentence
            return InputError(named, place=place)
        return InputError(self.thing if thing is None else thing, self.found, self.expected, place)

    def elsewhere(self) -> InputError:
        """Return the error for who is not of this machine: without where its files lie."""
        texts = (self.sentence or self.thing, self.found, self.expected)
        thing, found, expected = (text and FOLDERS.sub("", WHERE.sub("", text)) for text in texts)
        return InputError(thing or "", found, expected)

    def under(self, table: str) -> InputError:
        """Return the error with its thing as a part of another: `loop` makes `loop.cameras`."""
        if self.sentence or self.place:
            return self.at(thing=table) if self.sentence and not self.place else self
        between = "." if self.thing and self.thing[0] != "[" else ""
        return self.at(thing=f"{table}{between}{self.thing}")

    def __str__(self) -> str:
        """Return the one line."""
        found = None if self.found is None else f"found {self.found}"
        expected = None if self.expected is None else f"expected {self.expected}"
        what = self.sentence or ", ".join(part for part in (found, expected) if part)
        if self.found == MISSING:
            what = f"missing: {self.expected}"
        return ": ".join(part for part in (self.place, self.thing, what) if part)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the parts from which another process makes the error again."""
        return InputError, self.args


def exit_code(error: BaseException) -> int:
    """Return the exit code of an error that nobody handled."""
    if isinstance(error, KeyboardInterrupt):  # the handler of other signals says which
        return Exit.SIGNAL + int(error.args[0] if error.args else signal.SIGINT)
    if isinstance(error, Fault):
        return error.code
    if not isinstance(error, (InputError, OSError)):
        return Exit.FAULT
    below: BaseException | None = error
    while below is not None:  # what a full disk caused is told as the input's fault
        if (isinstance(below, OSError) and below.errno in MACHINE) or str(below) in SQLITES:
            return Exit.FAULT
        below = below.__cause__ or below.__context__
    return Exit.REFUSED


def reason_of(error: BaseException) -> str:
    """Return why something failed, in one line; of an error of the system without its file."""
    said = (error.strerror if isinstance(error, OSError) else None) or error
    return " ".join(str(said).split()) or type(error).__name__
