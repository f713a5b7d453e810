"""A bounded spool file for rows while the database is away, allocated beforehand.

The file is allocated when all is well, so that a full disk cannot refuse it. It has two halves;
when both are full the older is given up: the newest rows are kept. Where no file can be had the
same bytes are kept in memory.
"""

from __future__ import annotations

import glob
import mmap
import os
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from e3pose.base import system
from e3pose.base.bounded import UNDECODABLE
from e3pose.base.errors import InputError
from e3pose.store.rows import Row, Run

FRAME = struct.Struct("<II")  # bytes of the content, its CRC-32
HEADER_BYTES = 64 * 1024  # the run, so that whoever finds the file knows where its rows belong
MAGIC = b"e3pose spool 1\n"
DEFAULT_BYTES = 32_000_000  # some 15 minutes of four people at 25 slots per second
MAX_BYTES = 1_000_000_000
ENDING = ".spool-"
MAX_SPOOLS = 64  # writers of one store at a time, and what they left when they were killed
END = b"\0" * FRAME.size
Rows = list[Row] | None  # of a frame; None of a damaged one


@dataclass
class _Half:
    """One half of the room: frames one after the other from `begin`.

    Attributes:
        begin: where its first frame is in the file.
        used: bytes of all its frames.
        read: bytes of those that were delivered.
        waiting: bytes and rows of each of the others.
        rows: of the others.
    """

    begin: int
    used: int = 0
    read: int = 0
    rows: int = 0
    waiting: deque[tuple[int, int]] = field(default_factory=deque)


@dataclass
class Spool:
    """Keeps rows until the database takes them.

    Attributes:
        run: whose rows they are.
        path: the file, which must not exist, or None for memory.
        capacity_bytes: of both halves.
        lost_rows: given up because more came than fits, or because they cannot be read back.
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
            self._handle = system.open_new(self.path, 0o600)
            # Held as long as we live, so that nobody else adopts the file.
            system.lock(self._handle)
            # Zeros, so that both halves end where they begin.
            system.reserve(self._handle, HEADER_BYTES + self.capacity_bytes)
            head = MAGIC + frame(msgspec.msgpack.encode(self.run))
            head += frame(msgspec.msgpack.encode(self.capacity_bytes))
            if len(head) > HEADER_BYTES:
                raise OSError("the run does not fit the head of a spool")
            system.write_at(self._handle, head, 0)
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
            self.lost_rows += older.rows
            # Marked empty before it is the newer one: read back in the order of its frames.
            self._halves = [newer, _Half(older.begin)]
        half = self._halves[-1]
        self._put(half.begin + half.used, content + END)
        half.used += len(content)
        half.rows += len(rows)
        half.waiting.append((len(content), len(rows)))
        if self._handle is not None:
            try:
                system.sync_content(self._handle)
            except OSError:
                self._leave_file()

    def oldest(self) -> list[Row]:
        """Return the oldest rows that were added together; empty when none wait.

        They stay until `drop`. Rows that cannot be read back are given up, and counted.
        """
        while (half := self._oldest_half()) is not None:
            size, count = half.waiting[0]
            rows = next(frames(self._get(half.begin + half.read, size)), None)
            if rows is not None:
                return rows
            self.lost_rows += count
            self.drop()
        return []

    def drop(self) -> None:
        """Drop the oldest rows that were added together."""
        half = self._oldest_half()
        if half is None:
            return
        size, rows = half.waiting.popleft()
        half.read += size
        half.rows -= rows
        if not half.waiting:
            half.used = half.read = 0
            self._put(half.begin, END)

    def close(self, keep: bool) -> None:
        """Close the file; with `keep` it stays for the next start, otherwise it is removed."""
        if self._handle is None:
            return
        if keep or self.path is None:
            os.close(self._handle)
        else:
            system.remove_open(self.path, self._handle)
        self._handle = None

    def _oldest_half(self) -> _Half | None:
        return next((half for half in self._halves if half.waiting), None)

    def _put(self, offset: int, content: bytes) -> None:
        if self._handle is not None:
            try:
                system.write_at(self._handle, content, offset)
                return
            except OSError:
                self._leave_file()
        if len(self._memory) < offset + len(content):
            self._memory.extend(bytes(offset + len(content) - len(self._memory)))
        self._memory[offset : offset + len(content)] = content

    def _get(self, offset: int, size: int) -> bytes:
        if self._handle is None:
            return bytes(self._memory[offset : offset + size])
        try:
            return system.read_at(self._handle, size, offset)
        except OSError:
            return b""

    def _leave_file(self) -> None:
        """Go on in memory where the disk takes no more; the file stays for the next start."""
        for half in self._halves:
            content = self._get(half.begin, half.used)
            missing = half.begin + half.used - len(self._memory)
            self._memory.extend(bytes(max(missing, 0)))
            self._memory[half.begin : half.begin + len(content)] = content
        self.close(keep=True)


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
    """Return all spools beside a store."""
    return sorted(store.parent.glob(f"{glob.escape(store.name)}{ENDING}[0-9]*"))


def frame(content: bytes) -> bytes:
    """Return content behind its length and checksum."""
    return FRAME.pack(len(content), zlib.crc32(content)) + content


def content_at(
    content: bytes | mmap.mmap, at: int, end: int | None = None
) -> tuple[bytes | None, int]:
    """Return the content of a frame, None if damaged, and the offset of the next one."""
    if at + FRAME.size > len(content):
        return None, at
    size, checksum = FRAME.unpack(content[at : at + FRAME.size])
    begin = at + FRAME.size
    part = content[begin : min(begin + size, len(content) if end is None else end)]
    return part if zlib.crc32(part) == checksum and len(part) == size else None, begin + size


def frames(content: bytes | mmap.mmap, at: int = 0) -> Iterator[Rows]:
    """Yield the rows of every frame up to the first that is empty; None for a damaged one."""
    while at + FRAME.size <= len(content) and content[at : at + 4] != END[:4]:
        part, at = content_at(content, at)
        rows = None
        if part is not None:
            with suppress(*UNDECODABLE):
                rows = msgspec.msgpack.decode(part, type=list[Row])
        yield rows


class LeftSpool:
    """The spool of a killed process, open and locked until it is closed."""

    def __init__(self, path: Path) -> None:
        """Open and lock it.

        Raises:
            BlockingIOError: while its owner is running.
            InputError: when the file is not a spool.
        """
        self.path = path
        with path.open("r+b") as file:
            system.lock(file.fileno())
            size = os.fstat(file.fileno()).st_size
            if not 0 < size <= HEADER_BYTES + MAX_BYTES:
                raise InputError(f"{path}: found {size} bytes, expected a spool that e3pose wrote")
            self._content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            self._lock = os.dup(file.fileno())  # the lock is held while a handle is open
        try:
            self.run, self._capacity_bytes = self._read_head()
        except InputError:
            self.close()
            raise

    def frames(self) -> Iterator[Rows]:
        """Yield rows that were added together, by half; None where content is damaged."""
        size = len(self._content) - HEADER_BYTES
        yield from frames(self._content, HEADER_BYTES)
        yield from frames(self._content, HEADER_BYTES + (self._capacity_bytes or size) // 2)
        if self._capacity_bytes not in (0, size):
            yield None  # it was cut off

    def close(self) -> None:
        """Let the file go."""
        self._content.close()
        os.close(self._lock)

    def _read_head(self) -> tuple[Run, int]:
        """Return the owner of the rows and the bytes of both halves; 0 if not stated."""
        if self._content[: len(MAGIC)] != MAGIC:
            raise InputError(f"{self.path}: found no spool that e3pose wrote")
        run, after = content_at(self._content, len(MAGIC), HEADER_BYTES)
        if run is None:
            raise InputError(f"{self.path}: found a damaged head, expected whose rows these are")
        capacity, _ = content_at(self._content, after, HEADER_BYTES)
        try:
            found = msgspec.msgpack.decode(run, type=Run)
            stated = msgspec.msgpack.decode(capacity, type=int) if capacity else 0
            return found, min(max(stated, 0), MAX_BYTES)
        except UNDECODABLE as error:
            raise InputError(f"{self.path}: found a spool of another version ({error})") from None
