"""A bounded spool file for rows while the database is away, allocated beforehand.

The file is allocated when all is well, so that a full disk cannot refuse it. It has two halves;
when both are full the older is given up: the newest rows are kept. Where no file can be had the
same bytes are kept in memory.
"""

from __future__ import annotations

import fcntl
import glob
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from e3pose.errors import InputError
from e3pose.store.rows import Row, Run

FRAME = struct.Struct("<II")  # bytes of the content, its CRC-32
HEADER_BYTES = 64 * 1024  # the run, so that whoever finds the file knows where its rows belong
MAGIC = b"e3pose spool 1\n"
DEFAULT_BYTES = 32_000_000  # some 15 minutes of four people at 25 slots per second
ENDING = ".spool-"
MAX_SPOOLS = 64  # writers of one store at a time, and what they left when they were killed
END = b"\0" * FRAME.size


@dataclass
class _Half:
    """One half of the room: frames one after the other from `begin`."""

    begin: int
    used: int = 0
    rows: int = 0


@dataclass
class Spool:
    """Keeps rows until the database takes them.

    Attributes:
        run: whose rows they are.
        path: the file, which must not exist, or None for memory.
        capacity_bytes: of both halves.
        lost_rows: given up because more came than fits.
    """

    run: Run
    path: Path | None
    capacity_bytes: int = DEFAULT_BYTES
    lost_rows: int = 0
    _handle: int | None = None
    _memory: bytearray = field(default_factory=bytearray)
    _halves: list[_Half] = field(default_factory=list)

    def __post_init__(self) -> None:
        half = self.capacity_bytes // 2
        self._halves = [_Half(HEADER_BYTES), _Half(HEADER_BYTES + half)]
        if self.path is None:
            return
        try:
            # Never one that is there: it may hold what somebody could not deliver.
            self._handle = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
            # Held as long as we live, so that nobody else adopts the file.
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.posix_fallocate(self._handle, 0, HEADER_BYTES + self.capacity_bytes)
            head = MAGIC + frame(msgspec.msgpack.encode(self.run))
            if len(head) > HEADER_BYTES:
                raise OSError("the run does not fit the head of a spool")
            self._put(0, head)
            for part in self._halves:
                self._put(part.begin, END)
        except OSError:
            self.close(keep=False)

    @property
    def in_file(self) -> bool:
        """Whether the rows would survive this process."""
        return self._handle is not None

    def __len__(self) -> int:
        return sum(half.rows for half in self._halves)

    def add(self, rows: Sequence[Row]) -> None:
        """Add rows; drops the older half when the spool is full."""
        if not rows:
            return
        content = frame(msgspec.msgpack.encode(rows))
        room = self.capacity_bytes // 2 - len(END)
        if len(content) > room:
            if len(rows) == 1:
                self.lost_rows += 1
                return
            middle = len(rows) // 2
            self.add(rows[:middle])
            self.add(rows[middle:])
            return
        if self._halves[-1].used + len(content) > room:
            older, newer = self._halves
            if older.used:
                self.lost_rows += older.rows
            # Marked empty before it is the newer one: read back in the order of its frames.
            self._halves = [newer, _Half(older.begin)]
        half = self._halves[-1]
        self._put(half.begin + half.used, content + END)
        half.used += len(content)
        half.rows += len(rows)
        if self._handle is not None:
            os.fdatasync(self._handle)

    def take(self) -> Iterator[list[Row]]:
        """Yield the rows, oldest first; `clear` them once the database has them."""
        for half in self._halves:
            if half.used:
                yield from frames(self._get(half.begin, half.used))

    def clear(self) -> None:
        """Drop all rows."""
        for half in self._halves:
            half.used = half.rows = 0
            self._put(half.begin, END)

    def close(self, keep: bool) -> None:
        """Close the file; with `keep` it stays for the next start, otherwise it is removed."""
        if self._handle is None:
            return
        if not keep and self.path is not None:
            self.path.unlink(missing_ok=True)
        os.close(self._handle)
        self._handle = None

    def _put(self, offset: int, content: bytes) -> None:
        if self._handle is not None:
            os.pwrite(self._handle, content, offset)
            return
        if len(self._memory) < offset + len(content):
            self._memory.extend(bytes(offset + len(content) - len(self._memory)))
        self._memory[offset : offset + len(content)] = content

    def _get(self, offset: int, size: int) -> bytes:
        if self._handle is not None:
            return os.pread(self._handle, size, offset)
        return bytes(self._memory[offset : offset + size])


def new_spool(run: Run, store: Path | None, capacity_bytes: int) -> Spool:
    """Return a spool in a file beside the store, or in memory where there is no room for one."""
    if store is not None:
        for number in range(1, MAX_SPOOLS + 1):
            path = store.with_name(f"{store.name}{ENDING}{number}")
            if not path.exists():
                spool = Spool(run, path, capacity_bytes)
                if spool.in_file:
                    return spool
    return Spool(run, None, capacity_bytes)


def spools_of(store: Path) -> list[Path]:
    """Return the spools beside a store, whoever they belong to."""
    return sorted(store.parent.glob(f"{glob.escape(store.name)}{ENDING}[0-9]*"))


def frame(content: bytes) -> bytes:
    """Return content behind its length and checksum."""
    return FRAME.pack(len(content), zlib.crc32(content)) + content


def frames(content: bytes) -> Iterator[list[Row]]:
    """Yield the rows of every whole frame; ends at the first that is empty, cut off or damaged."""
    at = 0
    while (part := _frame_at(content, at)) is not None:
        at += FRAME.size + len(part)
        try:
            yield msgspec.msgpack.decode(part, type=list[Row])
        except (msgspec.DecodeError, UnicodeDecodeError):
            return


def left_behind(path: Path, limit_bytes: int = 2**30) -> tuple[Run, list[list[Row]]] | None:
    """Return the spool of a killed process; None while its owner is running.

    Raises:
        InputError: when the file is not a spool.
    """
    with path.open("r+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return None
        size = os.fstat(file.fileno()).st_size
        if size > limit_bytes:
            raise InputError(f"{path}: found {size} bytes, expected a spool of {limit_bytes}")
        content = file.read()
    head = _frame_at(content, len(MAGIC)) if content.startswith(MAGIC) else None
    if head is None:
        raise InputError(f"{path}: found no spool that e3pose wrote")
    try:
        run = msgspec.msgpack.decode(head, type=Run)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: found a spool of another version ({error})") from None
    body = content[HEADER_BYTES:]
    middle = len(body) // 2
    return run, [*frames(body[:middle]), *frames(body[middle:])]


def _frame_at(content: bytes, at: int) -> bytes | None:
    if at + FRAME.size > len(content):
        return None
    size, checksum = FRAME.unpack_from(content, at)
    part = content[at + FRAME.size : at + FRAME.size + size]
    return part if size and len(part) == size and zlib.crc32(part) == checksum else None
