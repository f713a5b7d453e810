"""A list whose items wait in a file: hours of slots do not fit into memory."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Sequence
from contextlib import suppress
from os import SEEK_END
from tempfile import TemporaryFile, gettempdir
from typing import IO, Any, TypeVar
from weakref import finalize

Item = TypeVar("Item")
BLOCK = 256  # items in memory; more go to the file, as many at a time


class DiskList(Sequence[Item]):
    """Items in a temporary file, a block of them in memory; for one thread at a time.

    An item that is read again is another object: whoever changes it changes nothing here.
    """

    def __init__(self, items: Iterable[Item] = (), backwards: bool = False) -> None:
        """Take items in their order, or with `backwards` the last first."""
        self._file: IO[bytes] | None = None  # until a block is full
        self._begins, self._last = list[int](), list[Item]()
        self._read: tuple[int, list[Item]] = -1, []
        self._size = BLOCK
        self._backwards = backwards
        for item in items:
            self.append(item)

    def append(self, item: Item) -> None:
        """Add an item at the end, or with `backwards` at the begin.

        Raises:
            OSError: naming the folder of temporary files, when there is no room for another block.
        """
        if len(self._last) == self._size:
            if self._file is None:
                self._file = TemporaryFile()  # noqa: SIM115  # as long as this object
                finalize(self, _close, self._file)
            try:
                begin = self._file.seek(0, SEEK_END)
                pickle.dump(self._last, self._file, pickle.HIGHEST_PROTOCOL)
                self._file.flush()
            except OSError as error:  # of a file without a name
                raise OSError(error.errno, error.strerror, gettempdir()) from None
            self._begins.append(begin)
            self._last = []
        self._last.append(item)

    def __len__(self) -> int:
        return self._size * len(self._begins) + len(self._last)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return [self[row] for row in range(*at.indices(len(self)))]
        if not -len(self) <= at < len(self):
            raise IndexError(at)
        at %= len(self)
        number, row = divmod(len(self) - 1 - at if self._backwards else at, self._size)
        if number == len(self._begins):
            return self._last[row]
        if number != self._read[0]:
            assert self._file is not None, "a block was written"
            self._file.seek(self._begins[number])
            self._read = number, pickle.load(self._file)  # written by this object
        return self._read[1][row]


def _close(file: IO[bytes]) -> None:
    with suppress(OSError):  # it writes once more what a full disk did not take
        file.close()
