"""Permissions of private files: the owner alone, or the group of a shared folder.

A folder is shared with its group by its setgid bit (`chmod g+s`), which also makes the system give
all that is made in it to that group.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import IO

from e3pose.base import system
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of

MAX_SECRET_BYTES = 4096


def shared(folder: Path) -> bool:
    """Return whether the group of a folder may read files made in it."""
    try:
        return bool(folder.stat().st_mode & stat.S_ISGID)
    except OSError:
        return False


def file_mode(folder: Path) -> int:
    """Return the mode of a new file in a folder."""
    return 0o640 if shared(folder) else 0o600


def folder_mode(folder: Path) -> int:
    """Return the mode of a new folder in a folder."""
    return 0o2750 if shared(folder) else 0o700


def make_folder(path: Path) -> None:
    """Make a folder and those above it that are missing; one that is there stays as it is."""
    if path.is_dir():
        return
    make_folder(path.parent)
    try:
        path.mkdir(0o700)
    except FileExistsError:
        if not path.is_dir():
            raise
        return
    if shared(path.parent):
        with suppress(PermissionError):  # a service that may not set such bits keeps it to itself
            path.chmod(folder_mode(path.parent))


def make_file(path: Path) -> None:
    """Make an empty file; one that is there stays as it is."""
    try:
        handle = system.open_new(path, 0o600)
    except FileExistsError:
        return
    try:
        system.set_mode(handle, file_mode(path.parent))
    finally:
        os.close(handle)


def append_to(path: Path) -> IO[bytes]:
    """Open a file for appending bytes, made if it is missing."""
    make_file(path)
    return path.open("ab")


def read_secret(path: Path, name: str) -> str:
    """Return the line of a file that its owner alone can read, or the group of a shared folder.

    Args:
        path: the file.
        name: of the setting, for messages.

    Raises:
        InputError: when it is no such file, others can read it, or it is empty.
    """
    wanted = "a file that its owner alone can read (chmod 600)"
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise InputError(name, f"{path} ({reason_of(error)})", wanted) from None
    if mode & (0o007 if shared(path.parent) else 0o077):
        raise InputError(name, f"{path}, which others can read", wanted)
    try:
        secret = read_bytes(path, MAX_SECRET_BYTES).decode().strip("\r\n")
    except UnicodeDecodeError:
        raise InputError(name, f"{path}, which is no text", wanted) from None
    if not secret:
        raise InputError(name, f"{path}, which is empty", "a file with one line")
    return secret
