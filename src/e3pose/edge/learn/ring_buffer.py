"""The poses of the last hours on disk: a bounded ring of atomic files."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.recording.arrays import load_arrays

FORMAT_VERSION = 1
MAX_CHUNK_POSES = 20_000  # a file of 5 MB with 17 joints
MAX_FILES = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Some seconds of poses, a row for every person in every slot.

    Attributes:
        run: when the run of the system began that track ids and slots belong to; as good as unique.
        slots: `(num_poses,)` rising.
        people: `(num_poses,)` in half and single precision.
    """

    run: int
    slots: NDArray[np.int64]
    people: People


@dataclass(slots=True)
class Gathering:
    """Slots in memory, before they become a file.

    Attributes:
        run: that they belong to.
        records: slots with people.
        poses: in all of them.
    """

    run: int
    records: list[SlotRecord] = field(default_factory=list)
    poses: int = 0

    def add(self, record: SlotRecord) -> None:
        """Add a slot; slots without an active camera are skipped."""
        if len(record.people) and record.arrived.any():
            self.records.append(record)
            self.poses += len(record.people)

    def full(self, slots: int) -> bool:
        """Tell whether `slots` slots have passed since the first, or memory is used up."""
        if not self.records:
            return False
        passed = self.records[-1].slot - self.records[0].slot + 1
        return passed >= slots or self.poses >= MAX_CHUNK_POSES

    def chunk(self) -> Chunk:
        """Return the collected slots."""
        counts = [len(record.people) for record in self.records]
        return Chunk(
            self.run,
            np.repeat([record.slot for record in self.records], counts).astype(np.int64),
            People(
                np.concatenate([record.people.track_ids for record in self.records]),
                np.concatenate([r.people.joints_m for r in self.records]).astype(np.float32),
                np.concatenate([r.people.scores for r in self.records]).astype(np.float16),
            ),
        )


class Ring:
    """The files of a folder, oldest first; their numbers rise for ever."""

    def __init__(self, folder: Path, skeleton: Skeleton, max_bytes: int) -> None:
        make_folder(folder)
        self.folder, self.skeleton, self.max_bytes = folder, skeleton, max_bytes
        numbers = [int(path.stem) for path in self.files()]
        self.next = max(numbers, default=0) + 1

    def files(self) -> list[Path]:
        """Return the files, oldest first."""
        return sorted(
            path
            for path in self.folder.glob("*.npz")
            if path.stem.isdecimal() and len(path.stem) == 8
        )[-MAX_FILES:]

    def write(self, chunk: Chunk) -> Path:
        """Write a file, and drop the oldest ones beyond the bound."""
        path = self.folder / f"{self.next:08d}.npz"
        _write(path, chunk, self.skeleton.joints)
        self.next += 1
        total = 0
        for written in reversed(self.files()):
            total += written.stat().st_size
            if total > self.max_bytes:
                written.unlink(missing_ok=True)
        return path


def _write(path: Path, chunk: Chunk, joints: Sequence[str]) -> None:
    with atomic_file(path, private=True) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            version=np.array([FORMAT_VERSION]),
            run=np.array([chunk.run]),
            joints=np.array(joints),
            slots=chunk.slots,
            track_ids=chunk.people.track_ids,
            joints_m=chunk.people.joints_m,
            scores=chunk.people.scores,
        )


def forget_poses(
    path: Path, joints: Sequence[str], track_ids: Collection[int], span_ns: tuple[int, int]
) -> int:
    """Delete the poses of a person from a file; return how many there were.

    A file that cannot be read, of which nothing is learned either, goes as a whole.

    Args:
        path: the file.
        joints: of the site.
        track_ids: of the person, who was there in `span_ns` (first, last) alone.
        span_ns: nanoseconds since 1970.
    """
    try:
        chunk = load_chunk(path, joints)
    except InputError:
        path.unlink(missing_ok=True)
        return 0
    if chunk.run > span_ns[1] or path.stat().st_mtime_ns < span_ns[0]:
        return 0
    kept = ~np.isin(chunk.people.track_ids, list(track_ids))
    if not kept.any():
        path.unlink(missing_ok=True)
    elif not kept.all():
        people = chunk.people
        left = People(people.track_ids[kept], people.joints_m[kept], people.scores[kept])
        _write(path, Chunk(chunk.run, chunk.slots[kept], left), joints)
    return int((~kept).sum())


def load_chunk(path: Path, joints: Sequence[str]) -> Chunk:
    """Return the poses of a file.

    Raises:
        InputError: when it is damaged, of another version, or of another skeleton.
    """
    number = len(joints)
    arrays = load_arrays(
        path,
        {
            "version": (1,),
            "run": (1,),
            "joints": ("names",),
            "slots": ("num_poses",),
            "track_ids": ("num_poses",),
            "joints_m": ("num_poses", number, 3),
            "scores": ("num_poses", number),
        },
    )
    if arrays["version"].tolist() != [FORMAT_VERSION]:
        raise InputError(f"{path}: version: found another one, expected {FORMAT_VERSION}")
    if arrays["joints"].tolist() != list(joints):
        raise InputError(f"{path}: joints: found another skeleton's")
    kinds = {"run": "i", "slots": "i", "track_ids": "i", "joints_m": "f", "scores": "f"}
    for name, kind in kinds.items():
        if arrays[name].dtype.kind != kind:
            raise InputError(f"{path}: {name}: found {arrays[name].dtype}, expected numbers")
    if (np.diff(arrays["slots"].astype(np.int64)) < 0).any():
        raise InputError(f"{path}: slots: found some that fall")
    return Chunk(
        int(arrays["run"].astype(np.int64)[0]),
        arrays["slots"].astype(np.int64),
        People(
            arrays["track_ids"].astype(np.int64),
            arrays["joints_m"].astype(np.float32),
            arrays["scores"].astype(np.float16),
        ),
    )


def slots_in(path: Path, joints: Sequence[str]) -> int:
    """Return the number of slots with people in a file; 0 if it is unusable.

    Nothing else of the file is read, so that a system with hours of poses starts at once.
    """
    try:
        arrays = load_arrays(path, {"joints": ("names",), "slots": ("num_poses",)})
    except InputError:
        return 0
    usable = arrays["joints"].tolist() == list(joints) and arrays["slots"].dtype.kind == "i"
    return len(np.unique(arrays["slots"])) if usable else 0
