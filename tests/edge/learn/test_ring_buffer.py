"""The ring of poses on disk: bounded, whole or not there, read without trust."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.edge.learn.ring_buffer import Gathering, Ring, load_chunk, slots_in
from e3pose.model.people import People
from e3pose.model.skeleton import BODY25, COCO17
from e3pose.pipeline import SlotRecord


def record(slot: int, people: int = 2, looked: bool = True) -> SlotRecord:
    joints = np.full((people, 17, 3), float(slot))
    found = People(np.arange(people), joints, np.full((people, 17), 0.5))
    all_on, zero, arrived = np.ones(3, dtype=bool), np.zeros(3), np.full(3, looked)
    return SlotRecord(slot, 0.04 * slot, all_on, arrived, found, zero, zero, all_on)


def gathered(first: int, stop: int, run: int = 7) -> Gathering:
    gathering = Gathering(run)
    for slot in range(first, stop):
        gathering.add(record(slot))
    return gathering


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = Ring(tmp_path, COCO17, 2**30).write(gathered(5, 25).chunk())
    chunk = load_chunk(path, COCO17.joints)
    assert chunk.run == 7
    assert chunk.slots.tolist() == [s for s in range(5, 25) for _ in range(2)]
    assert chunk.people.track_ids.tolist() == [0, 1] * 20
    assert (chunk.people.joints_m == chunk.slots[:, None, None]).all()
    assert slots_in(path, COCO17.joints) == 20


def test_slots_that_show_the_past_or_nobody_teach_nothing() -> None:
    gathering = Gathering(0)
    gathering.add(record(0, looked=False))
    gathering.add(record(1, people=0))
    assert gathering.records == [] and not gathering.full(1)


def test_a_chunk_is_full_by_time_or_by_people() -> None:
    assert not gathered(0, 9).full(10)
    assert gathered(0, 10).full(10)
    crowd = Gathering(0)
    crowd.add(record(0, people=20_000))
    assert crowd.full(1000)


def test_the_oldest_files_go_and_numbers_rise_over_restarts(tmp_path: Path) -> None:
    size = Ring(tmp_path / "probe", COCO17, 2**30).write(gathered(0, 20).chunk()).stat().st_size
    for _ in range(3):  # three runs of the system
        ring = Ring(tmp_path / "ring", COCO17, 4 * size + size // 2)
        for _ in range(3):
            ring.write(gathered(0, 20).chunk())
    assert [path.stem for path in ring.files()] == ["00000006", "00000007", "00000008", "00000009"]


def test_a_half_written_file_is_not_there(tmp_path: Path) -> None:
    ring = Ring(tmp_path, COCO17, 2**30)
    (tmp_path / ".00000001.npz.abc.npz").write_bytes(b"half")
    (tmp_path / "notes.npz").write_bytes(b"somebody's")
    assert ring.files() == []


def saved(path: Path, **changes: Any) -> Path:
    content: dict[str, Any] = {
        "version": np.array([1]),
        "run": np.array([1]),
        "joints": np.array(COCO17.joints),
        "slots": np.arange(3),
        "track_ids": np.zeros(3, dtype=np.int64),
        "joints_m": np.zeros((3, 17, 3), np.float32),
        "scores": np.zeros((3, 17), np.float16),
    }
    np.savez(path, **{**content, **changes})
    return path


def test_hostile_files_are_refused(tmp_path: Path) -> None:
    good = saved(tmp_path / "good.npz")
    assert load_chunk(good, COCO17.joints).run == 1
    content = good.read_bytes()
    bad = [
        saved(tmp_path / "version.npz", version=np.array([9])),
        saved(tmp_path / "shape.npz", joints_m=np.zeros((3, 16, 3), np.float32)),
        saved(tmp_path / "length.npz", scores=np.zeros((4, 17), np.float16)),
        saved(tmp_path / "kind.npz", slots=np.zeros(3)),
        saved(tmp_path / "order.npz", slots=np.array([3, 2, 1])),
        saved(tmp_path / "pickle.npz", run=np.array([{"a": 1}], dtype=object)),
        saved(tmp_path / "names.npz", joints=np.array(BODY25.joints)),
    ]
    for name, damaged in (
        ("cut", content[: len(content) // 2]),
        ("empty", b""),
        ("noise", bytes(range(256)) * 9),
    ):
        (tmp_path / f"{name}.npz").write_bytes(damaged)
        bad.append(tmp_path / f"{name}.npz")
    for path in bad:
        with pytest.raises(InputError, match=path.name):
            load_chunk(path, COCO17.joints)
    for path in bad[-4:]:  # of another skeleton, or no file of poses at all
        assert slots_in(path, COCO17.joints) == 0
