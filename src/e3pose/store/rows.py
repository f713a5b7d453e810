"""Rows of a store: pure encoding, validated when read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.dynamics import packed
from e3pose.model.skeleton import Skeleton, skeleton_of_joints
from e3pose.model.zone_event import ZoneEvent
from e3pose.pipeline import SlotRecord

Row = tuple[str, dict[str, Any]]  # table name and columns, less the run id

NS = 1_000_000_000
MAX_TEXT = 500
RECORDING = "recording"  # source of the part of a reading that recording video took, in its own row
SMALLEST_SCORE = 1e-4  # halves have 6e-5 as their smallest of full precision


@dataclass(frozen=True, slots=True)
class Run:
    """One life of a pipeline at one site.

    A program that goes on where it was killed passes the same site and start, and goes on in the
    same run.

    Attributes:
        site: name of the site.
        name: what a person calls this run, such as the recording's name.
        started_ns: time of slot 0 since 1970, UTC.
        interval_s: seconds per slot.
        skeleton: name of the skeleton.
        joints: its joint names, in axis order.
        cameras: camera ids of the rig, in axis order.
        software: what wrote it.
        own_skeleton: `own_file` of the skeleton.
    """

    site: str
    name: str
    started_ns: int
    interval_s: float
    skeleton: str
    joints: tuple[str, ...]
    cameras: tuple[str, ...]
    software: str = ""
    own_skeleton: str = ""

    @property
    def limbed(self) -> Skeleton:
        """The skeleton, with limbs where they are known."""
        return skeleton_of_joints(self.joints, self.skeleton, self.own_skeleton)

    def row(self) -> dict[str, Any]:
        """Return the columns of the table `runs`, less the id."""
        return {
            "site": self.site,
            "name": self.name,
            "started_ns": self.started_ns,
            "interval_ns": round(self.interval_s * NS),
            "skeleton": self.skeleton,
            "joints": json.dumps(self.joints),
            "cameras": json.dumps(self.cameras),
            "software": self.software,
            **({"own_skeleton": self.own_skeleton} if self.own_skeleton else {}),
        }


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth telling later: a camera lost, a disk full.

    Attributes:
        time_ns: when, since 1970, UTC.
        kind: one word, such as `camera-lost`.
        message: one line.
        camera_id: the camera it is about, if it is about one.
        track_id: the person it is about; -1 of one about nobody, None of one about the site.
        zone: where; empty where it is in none.
        phase: of what people do: `begun` or `ended`.
        start_ns: when it began.
        score: probability that it is so.
    """

    time_ns: int
    kind: str
    message: str
    camera_id: str | None = None
    track_id: int | None = None
    zone: str | None = None
    phase: str | None = None
    start_ns: int | None = None
    score: float | None = None


@dataclass(frozen=True, slots=True)
class EnergyReading:
    """A camera's meter reading since the previous one.

    Attributes:
        time_ns: end of that time, since 1970, UTC.
        camera_id: the camera.
        energy_j: joules spent in it.
        span_s: seconds it lasted.
        source: whether and how it was measured, such as `measured: VDD_IN`, `modelled: xavier-nx`.
        charge: of the battery, [0, 1], where one is known.
    """

    time_ns: int
    camera_id: str
    energy_j: float
    span_s: float
    source: str
    charge: float | None = None


@dataclass(frozen=True, slots=True)
class Presence:
    """States of people in a slot, for summaries; not stored.

    Attributes:
        time_ns: when, since 1970, UTC.
        states: how many people are in each, sums of probabilities.
    """

    time_ns: int
    states: Mapping[str, float]


def slot_rows(
    record: SlotRecord,
    time_ns: int,
    energy_j: Floats | None = None,
) -> list[Row]:
    """Return the rows of one slot.

    Args:
        record: what the slot left behind.
        time_ns: when it was captured, since 1970, UTC.
        energy_j: `(num_cameras,)` joules that the slot is charged with, where known.

    Raises:
        InputError: when the parts do not fit together.
    """
    people = record.people
    if energy_j is not None and np.shape(energy_j) != record.selected.shape:
        raise InputError(
            f"slot {record.slot}: energy: found shape {np.shape(energy_j)}, "
            f"expected {record.selected.shape}"
        )
    slot = {
        "slot": record.slot,
        "time_ns": time_ns,
        "selected": flags_text(record.selected),
        "arrived": flags_text(record.arrived),
        "next_selection": flags_text(record.next_selection),
        "occlusion": _blob(record.occlusion),
        "deficit": _blob(record.deficit),
        "energy_j": None if energy_j is None else _blob(energy_j),
        "took_s": float(sum(record.stage_s.values())),
        "blind": record.blind,
    }
    rows: list[Row] = [("slots", slot)]
    joints_m = people.joints_m.astype("<f4")
    # Half precision would take a very small score for a missing joint.
    scores = people.scores
    scores = np.where(scores > 0, np.maximum(scores, SMALLEST_SCORE), 0.0).astype("<f2")
    sigma = None if np.isnan(people.sigma_m).all() else people.sigma_m.astype("<f2")
    measured = np.packbits(people.measured, axis=-1)
    dynamics = None if people.dynamics is None else packed(people.dynamics)
    for person, track_id in enumerate(people.track_ids.tolist()):
        rows.append(
            (
                "poses",
                {
                    "slot": record.slot,
                    "track_id": track_id,
                    "time_ns": time_ns,
                    "joints_m": joints_m[person].tobytes(),
                    "scores": scores[person].tobytes(),
                    "sigma_m": None if sigma is None else sigma[person].tobytes(),
                    "measured": measured[person].tobytes(),
                    "dynamics": None if dynamics is None else dynamics[person].tobytes(),
                },
            )
        )
    return rows


def event_row(event: Event, number: int) -> Row:
    """Return the row of an event; `number` tells events of the same nanosecond apart."""
    return (
        "events",
        {
            "time_ns": event.time_ns,
            "number": number,
            "kind": event.kind[:MAX_TEXT],
            "camera_id": event.camera_id,
            "message": event.message[:MAX_TEXT],
            "track_id": event.track_id,
            "zone": event.zone and event.zone[:MAX_TEXT],
            "phase": event.phase,
            "start_ns": event.start_ns,
            "score": event.score,
        },
    )


def energy_row(reading: EnergyReading) -> Row:
    """Return the row of a meter's reading."""
    return (
        "energy",
        {
            "time_ns": reading.time_ns,
            "camera_id": reading.camera_id,
            "energy_j": float(reading.energy_j),
            "span_s": float(reading.span_s),
            "charge": None if reading.charge is None else float(reading.charge),
            "source": reading.source[:MAX_TEXT],
        },
    )


def zone_row(event: ZoneEvent) -> Row:
    """Return the row of a zone event."""
    return (
        "zones",
        {
            "time_ns": event.time_ns,
            "zone": event.zone[:MAX_TEXT],
            "track_id": event.track,
            "kind": event.kind,
            "slot": event.slot,
            "count": event.count,
            "stayed_s": float(event.stayed_s),
        },
    )


def track_rows(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return one row of `tracks` for every track among rows of `poses`: when it was there."""
    seen: dict[int, dict[str, Any]] = {}
    for table, row in rows:
        if table != "poses":
            continue
        slot, time_ns, track_id = row["slot"], row["time_ns"], row["track_id"]
        track = seen.setdefault(
            track_id,
            {
                "track_id": track_id,
                "first_slot": slot,
                "last_slot": slot,
                "first_ns": time_ns,
                "last_ns": time_ns,
            },
        )
        track["first_slot"] = min(track["first_slot"], slot)
        track["last_slot"] = max(track["last_slot"], slot)
        track["first_ns"] = min(track["first_ns"], time_ns)
        track["last_ns"] = max(track["last_ns"], time_ns)
    return list(seen.values())


def flags_text(flags: NDArray[np.bool_]) -> str:
    """Return `(num_cameras,)` booleans as a text of 0 and 1, which any database tool shows."""
    return "".join("1" if flag else "0" for flag in flags.tolist())


def stack_blobs(
    blobs: Sequence[Any], dtype: str, shape: tuple[int, ...], where: str
) -> NDArray[Any]:
    """Return blobs as one `(num_blobs, *shape)` array; one that may be missing is NaN.

    Raises:
        InputError: when a blob has not the bytes of its shape.
    """
    size = np.dtype(dtype).itemsize * int(np.prod(shape, dtype=np.int64))
    empty = np.full(shape, np.nan, dtype=dtype).tobytes() if dtype[1] == "f" else None
    if blobs and set(map(type, blobs)) == {bytes} and set(map(len, blobs)) == {size}:
        return np.frombuffer(b"".join(blobs), dtype=dtype).reshape(len(blobs), *shape)
    parts = []
    for blob in blobs:
        part = empty if blob is None else blob
        if not isinstance(part, bytes) or len(part) != size:
            found = f"{len(part)} bytes" if isinstance(part, bytes) else type(part).__name__
            raise InputError(f"{where}: found {found}, expected {size} bytes")
        parts.append(part)
    return np.frombuffer(b"".join(parts), dtype=dtype).reshape(len(blobs), *shape)


def _blob(values: NDArray[Any]) -> bytes:
    blob: bytes = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return blob
