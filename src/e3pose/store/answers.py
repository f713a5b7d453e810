"""Query results: validated rows as arrays and records."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.dynamics import PACKED_SIZE, unpacked
from e3pose.model.people import People
from e3pose.store.rows import NS, Run, stack_blobs

MAX_JOINTS = 1000


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A stored run, with its id."""

    run_id: int
    run: Run


@dataclass(frozen=True, slots=True, eq=False)
class StoredPoses:
    """People at times, one row per person and slot, in the order of runs, slots and tracks.

    Attributes:
        run_ids: `(num_rows,)` runs.
        slots: `(num_rows,)` slots.
        time_ns: `(num_rows,)` nanoseconds since 1970, UTC.
        people: `(num_rows,)` people, in single precision.
        joints: names of the joint axis.
    """

    run_ids: NDArray[np.int64]
    slots: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    people: People
    joints: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.slots)


def stored_run(row: Any, where: str) -> StoredRun:
    """Return a run from its row; raise `InputError` for an invalid row."""
    try:
        joints, cameras = (tuple(map(str, json.loads(text))) for text in (row.joints, row.cameras))
    except (ValueError, TypeError, RecursionError):
        raise InputError(
            f"{where}: runs: run {row.run_id}: joints and cameras are no lists"
        ) from None
    if not 1 <= len(joints) <= MAX_JOINTS:
        raise InputError(f"{where}: runs: run {row.run_id}: found {len(joints)} joints")
    return StoredRun(
        row.run_id,
        Run(
            row.site, row.name, row.started_ns, row.interval_ns / NS, row.skeleton, joints,
            cameras, row.software, row.own_skeleton or "",
        ),
    )  # fmt: skip


def stored_poses(
    rows: Sequence[Any], joints: tuple[str, ...], num_joints: int, column: int | None, where: str
) -> StoredPoses:
    """Return rows of the table `poses` as arrays.

    Args:
        rows: of one run.
        joints: names of the joint axis of the answer.
        num_joints: joints of the run.
        column: the joint to keep, or None for all.
        where: the store, for messages.

    Raises:
        InputError: when a blob has not the size of its shape, or a score is none.
    """
    place = f"{where}: poses: run {rows[0].run_id}, slots from {rows[0].slot}" if rows else where
    # Turned as a whole: asking a thousand rows for each of their columns takes ten times as long.
    columns = dict(zip(rows[0]._fields, zip(*rows, strict=True), strict=True)) if rows else {}
    joints_m, scores, sigma_m, bits = (
        stack_blobs(columns.get(name, ()), dtype, shape, f"{place}: {name}")
        for name, dtype, shape in (
            ("joints_m", "<f4", (num_joints, 3)),
            ("scores", "<f2", (num_joints,)),
            ("sigma_m", "<f2", (num_joints,)),
            ("measured", "|u1", (-(-num_joints // 8),)),
        )
    )
    empty = bytes(num_joints * PACKED_SIZE)
    codes = stack_blobs(
        [empty if blob is None else blob for blob in columns.get("dynamics", ())],
        "|u1",
        (num_joints, PACKED_SIZE),
        f"{place}: dynamics",
    )
    if not ((scores >= 0) & (scores <= 1)).all():
        raise InputError(f"{place}: scores: found one outside [0, 1]")
    chosen = slice(None) if column is None else slice(column, column + 1)
    names = ("run_id", "slot", "time_ns", "track_id")
    try:
        run_ids, slots, time_ns, track_ids = (
            np.array(columns.get(name, ()), dtype=np.int64) for name in names
        )
    except (ValueError, TypeError, OverflowError):
        raise InputError(
            f"{place}: {', '.join(names)}: found something else than numbers"
        ) from None
    missing = (scores <= 0)[..., None]
    measured = np.unpackbits(bits, axis=-1, count=num_joints).astype(bool)
    return StoredPoses(
        run_ids=run_ids,
        slots=slots,
        time_ns=time_ns,
        people=People(
            track_ids,
            joints_m[:, chosen],
            scores[:, chosen].astype(np.float32),
            measured[:, chosen],
            sigma_m[:, chosen].astype(np.float32),
            dynamics=unpacked(np.where(missing, np.uint8(0), codes)[:, chosen]),
        ),
        joints=joints,
    )


def cut(poses: StoredPoses, rows: slice) -> StoredPoses:
    """Return some rows of an answer."""
    numbers = poses.run_ids[rows], poses.slots[rows], poses.time_ns[rows]
    return StoredPoses(*numbers, poses.people[rows], poses.joints)


def joined(chunks: Sequence[StoredPoses]) -> StoredPoses:
    """Join the chunks of one answer."""
    joints = chunks[0].joints
    return StoredPoses(
        np.concatenate([chunk.run_ids for chunk in chunks]),
        np.concatenate([chunk.slots for chunk in chunks]),
        np.concatenate([chunk.time_ns for chunk in chunks]),
        People.joined([chunk.people for chunk in chunks], len(joints)),
        joints,
    )


def plain_row(row: dict[str, Any], num_cameras: int, where: str) -> dict[str, Any]:
    """Return a row with lists in the place of blobs."""
    for name in ("occlusion", "deficit", "energy_j"):
        blob = row.get(name)
        if isinstance(blob, bytes):
            place = f"{where}: slots: run {row['run_id']}, slot {row['slot']}: {name}"
            row[name] = stack_blobs([blob], "<f4", (num_cameras,), place)[0].tolist()
    return row
