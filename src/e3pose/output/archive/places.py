"""Where an archive lies: a folder, or any object store that fsspec knows."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol, TypeVar

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.installing import install_command

MOST_BYTES = 2**32  # of a file
T = TypeVar("T")


def _extra() -> str:
    return f"{install_command('archive')} and what its address needs, such as s3fs"


class Place(Protocol):
    """Holds files under names with slashes; each is there whole or not at all."""

    @property
    def name(self) -> str:
        """Its name, without passwords; the same for every spelling of the place."""
        ...

    def names(self, under: str = "") -> list[str]:
        """Return the names of all files, or of the files below a folder, sorted."""
        ...

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is none."""
        ...

    def write(self, name: str, content: bytes) -> None:
        """Write a file, in place of one that is there."""
        ...

    def remove(self, name: str) -> None:
        """Remove a file; one that is not there is none."""
        ...


class Folder:
    """A folder of this machine, or one that it has mounted; made when it is needed.

    No link in it is followed: a file that somebody else put there must not lead out of it.
    """

    def __init__(self, path: Path) -> None:
        """Name the folder."""
        self._path = Path(os.path.abspath(path))
        self.name = str(self._path)

    def names(self, under: str = "") -> list[str]:
        """Return the names of all files, or of the files below a folder, sorted."""
        found = (
            path
            for above, folders, names in os.walk(
                self._inside(f"{under}/_" if under else "_").parent
            )
            for path in (Path(above, name) for name in (*folders, *names))
            if path.is_symlink() or not path.is_dir()
        )
        return sorted(str(p.relative_to(self._path)) for p in found if not p.name.startswith("."))

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is none."""
        path = self._inside(name)
        return read_bytes(path, MOST_BYTES, links=False) if os.path.lexists(path) else None

    def write(self, name: str, content: bytes) -> None:
        """Write a file for its owner alone, as `base.private` says."""
        write_file(self._inside(name), content, private=True)

    def remove(self, name: str) -> None:
        """Remove a file, and the folder that it leaves empty."""
        path = self._inside(name)
        path.unlink(missing_ok=True)
        with suppress(OSError):
            path.parent.rmdir()

    def _inside(self, name: str) -> Path:
        """Return the path of a file; raise `InputError` where a folder above it is a link."""
        path = self._path
        for part in Path(name).parts:
            if path != self._path and path.is_symlink():
                raise InputError(f"{path}: found a link, expected a folder of the archive")
            path = path / part
        return path


class Bucket:
    """An object store by its address, such as s3://BUCKET/PREFIX."""

    def __init__(self, address: str) -> None:
        """Find what speaks to it; connects when it is used.

        Raises:
            InputError: when nothing is installed that does, or the address is none.
        """
        try:
            from fsspec.core import url_to_fs
        except ModuleNotFoundError:
            raise InputError(f"{address}: found no fsspec, expected it: {_extra()}") from None
        try:
            self._files, self._root = url_to_fs(address)
        except (ImportError, ValueError) as error:
            reason = reason_of(error)[:200]
            raise InputError(f"{address}: cannot be used ({reason}): {_extra()}") from None
        self._root = self._root.rstrip("/")
        self.name = f"{address.partition('://')[0]}://{self._root.lstrip('/')}"

    def names(self, under: str = "") -> list[str]:
        """Return the names of all files, or of the files below a folder, sorted."""
        self._files.invalidate_cache()
        place = f"{self._root}/{under}".rstrip("/")
        try:
            found = self._tried(lambda: self._files.find(place))
        except FileNotFoundError:
            return []
        return sorted(str(name)[len(self._root) :].lstrip("/") for name in found)

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is none."""
        try:
            return bytes(self._tried(lambda: self._files.cat_file(f"{self._root}/{name}")))
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file: an object store shows it when all of it has arrived."""
        path = f"{self._root}/{name}"

        def send() -> None:
            self._files.makedirs(path.rpartition("/")[0], exist_ok=True)
            self._files.pipe_file(path, content)

        self._tried(send)

    def remove(self, name: str) -> None:
        """Remove a file; one that is not there is none."""
        with suppress(FileNotFoundError):
            self._tried(lambda: self._files.rm_file(f"{self._root}/{name}"))

    def _tried(self, call: Callable[[], T]) -> T:
        """Call; say what went wrong whatever it is: each store has errors of its own."""
        try:
            return call()
        except FileNotFoundError:
            raise
        except Exception as error:
            reason = reason_of(error)[:200]
            raise InputError(f"{self.name}: cannot be used ({reason})") from None


def place_of(address: str) -> Place:
    """Return the place of an archive: a folder's path, or an address that fsspec knows."""
    if address.startswith("file://"):
        return Folder(Path(address.removeprefix("file://")))
    return Bucket(address) if "://" in address else Folder(Path(address))
