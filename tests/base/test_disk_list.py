"""Items that wait in a file: all come back, both ways, and few are in memory."""

from __future__ import annotations

import errno
import gc
import sys
import tempfile
from io import BufferedRandom, FileIO
from pathlib import Path
from typing import Any

import pytest

from e3pose.base import disk_list
from e3pose.base.disk_list import BLOCK, DiskList


class Item:
    """Something that can be counted."""

    def __init__(self, number: int) -> None:
        self.number = number


@pytest.mark.parametrize("count", [0, 1, BLOCK, 2 * BLOCK + 3])
def test_items_come_back_from_the_file_both_ways(count: int) -> None:
    for kept in (DiskList(range(count)), DiskList(reversed(range(count)), backwards=True)):
        wanted = [*range(count)]
        assert len(kept) == count and [*kept] == wanted
        assert [*reversed(kept)] == wanted[::-1]
        assert kept[::100] == wanted[::100] and kept[-3:] == wanted[-3:]
        with pytest.raises(IndexError):
            kept[count]


def test_few_items_are_in_memory_however_many_there_are() -> None:
    kept = DiskList(Item(number) for number in range(6 * BLOCK))
    assert sum(item.number for item in kept) == 3 * BLOCK * (6 * BLOCK - 1)
    assert sum(type(each) is Item for each in gc.get_objects()) <= 2 * BLOCK


def test_a_full_disk_is_named_once_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full(FileIO):
        def write(self, data: Any) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    unheard = list[object]()
    monkeypatch.setattr(sys, "unraisablehook", unheard.append)
    monkeypatch.setattr(
        disk_list, "TemporaryFile", lambda: BufferedRandom(Full(tmp_path / "items", "w+"))
    )
    kept = DiskList(range(BLOCK))
    for _ in range(2):
        with pytest.raises(OSError, match="No space left") as failed:
            kept.append(BLOCK)
        assert (failed.value.errno, failed.value.filename) == (errno.ENOSPC, tempfile.gettempdir())
        assert [*kept] == [*range(BLOCK)]
    del kept, failed
    gc.collect()
    assert not unheard
