"""Lock a file against a second writer, and name the program that holds it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from e3pose.base import system
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder

TRY_S = 0.02
MAX_OWNER_BYTES = 200


@contextmanager
def hold(path: Path, what: str = "", wait_s: float = 0.0) -> Iterator[None]:
    """Be the only program that writes at `path` until the block ends.

    The lock is the system's, on a file beside `path`: it ends with the process, however that ends.
    The file holds the number and the command of who has it, and goes away with the lock.

    Args:
        path: the file or folder to be written.
        what: of it, where several programs may each write a part of their own.
        wait_s: how long to wait for another program to be done.

    Raises:
        InputError: when another program writes there.
    """
    beside = lock_file(path, what)
    handle = _taken(beside, path, wait_s)
    try:
        yield
    finally:
        if handle is not None:
            system.remove_open(beside, handle)


def hold_all(written: Iterable[tuple[Path, str]], stack: ExitStack) -> None:
    """Be the only program that writes some files, until a stack is closed; see `hold`.

    Args:
        written: the files, each with what of it; their folders are made.
        stack: of what is to be closed.
    """
    for path, what in written:
        with suppress(OSError):  # reported when it is written
            make_folder(path.parent)
        stack.enter_context(hold(path, what))


def lock_file(path: Path, what: str = "") -> Path:
    """Return the file whose lock guards `path`, the same by whatever way it is named."""
    real = Path(os.path.realpath(path))
    part = "".join(char if char.isalnum() or char in "-_." else "_" for char in what)
    return real.with_name(f".{real.name}{'.' if part else ''}{part}.lock")


def _taken(beside: Path, path: Path, wait_s: float) -> int | None:
    """Return the handle that holds the lock; None where no lock can be had."""
    deadline_s = time.monotonic() + wait_s
    while True:
        try:
            handle = system.open_unlinked(beside, 0o600)
        except OSError:  # of a full or read-only disk, which the writing itself tells better
            return None
        try:
            system.lock(handle)
        except BlockingIOError:
            owner = _owner(handle)
            os.close(handle)
            if time.monotonic() >= deadline_s:
                raise InputError(
                    f"{path}: {owner} writes there already, expected one program at a time"
                ) from None
            time.sleep(TRY_S)
            continue
        except OSError:  # a file system without locks
            os.close(handle)
            return None
        if _is_at(handle, beside):
            _sign(handle)
            return handle
        os.close(handle)  # who had it before has removed the file meanwhile


def _is_at(handle: int, beside: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), beside.stat())
    except FileNotFoundError:
        return False


def _sign(handle: int) -> None:
    command = " ".join(["e3pose", *sys.argv[1:3]])
    try:
        os.ftruncate(handle, 0)
        system.write_at(handle, f"{os.getpid()} {command}".encode()[:MAX_OWNER_BYTES], 0)
    except OSError:  # a full disk: it is held all the same, without a name
        pass


def _owner(handle: int) -> str:
    text = system.read_at(handle, MAX_OWNER_BYTES, 0).decode(errors="replace")
    number, _, command = text.partition(" ")
    if not number.isdecimal():
        return "another program"
    shown = "".join(char for char in command if char.isprintable())
    return f"process {number} ({shown})"
