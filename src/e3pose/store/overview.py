"""Overviews of hours of a store: coverage, energy spent and saved, visits to zones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import Connection, and_, case, func, inspect, null, or_, select

from e3pose.energy.saving import Saving, charged, saving
from e3pose.store import schema
from e3pose.store.rows import RECORDING, stack_blobs

MEASURED = 0.95  # of the time, of a camera with a meter
METERED = 0.1  # that charges may differ from what meters read, to be learned from them
SLOTS_LOOKED_AT = 400_000  # of more, every second, third... is counted: it is a drawing
SCATTER, RANGE = 2_654_435_761, 2**32  # multiplied by it, slots are spread over the range


class Spent(NamedTuple):
    """Energy of a camera: joules, their seconds, and the measured share."""

    camera_id: str
    energy_j: float
    span_s: float
    measured: float


class StoredStay(NamedTuple):
    """A visit to a zone, in nanoseconds; `until_ns` is None while it lasts."""

    run_id: int
    track_id: int
    zone: str
    since_ns: int
    until_ns: int | None


def coverage(
    connection: Connection, start_ns: int, end_ns: int, parts: int
) -> tuple[list[int], list[int]]:
    """Return the numbers of stored and blind slots in equal parts of a period.

    Args:
        connection: to the store.
        start_ns: first time.
        end_ns: the time after the last.
        parts: into how many equal parts the time is cut.

    Returns:
        `(parts,)` slots and blind slots; estimated from every n-th slot where they are many.
    """
    slots = schema.slots.c
    inside = slots.time_ns.between(start_ns, end_ns - 1)
    count = connection.scalar(select(func.count()).select_from(schema.slots).where(inside)) or 0
    every = 1 + count // SLOTS_LOOKED_AT
    width_ns = -(-(end_ns - start_ns) // parts)
    part = ((slots.time_ns - start_ns) // width_ns).label("part")
    known = {column["name"] for column in inspect(connection).get_columns("slots")}
    blind: Any = func.sum(case((slots.blind != "", 1), else_=0)) if "blind" in known else 0
    asked = select(part, func.count(), blind).where(inside).group_by(part)
    if every > 1:
        asked = asked.where(slots.slot % every == 0)
    found: tuple[list[int], list[int]] = [0] * parts, [0] * parts
    for index, stored, unseen in connection.execute(asked):
        found[0][int(index)], found[1][int(index)] = every * stored, every * int(unseen)
    return found


def spent(connection: Connection, start_ns: int, end_ns: int) -> list[Spent]:
    """Return the energy of each camera between two times, by name.

    Args:
        connection: to the store.
        start_ns: first time.
        end_ns: last time.
    """
    energy = schema.energy.c
    span = case((energy.source == RECORDING, 0.0), else_=energy.span_s)
    measured = case((energy.source.like("measured%"), energy.span_s), else_=0.0)
    asked = (
        select(energy.camera_id, func.sum(energy.energy_j), func.sum(span), func.sum(measured))
        .where(energy.time_ns.between(start_ns, end_ns))
        .group_by(energy.camera_id)
        .order_by(energy.camera_id)
    )
    return [
        Spent(camera_id, energy_j, span_s, measured_s / span_s if span_s else 0.0)
        for camera_id, energy_j, span_s, measured_s in connection.execute(asked)
    ]


def saved(
    connection: Connection, start_ns: int, end_ns: int, active_w: Mapping[str, float], where: str
) -> Saving | None:
    """Return the saving of whole cameras between two times; None if no slot has it.

    Slots are those with the joules that they are charged with, blind ones left out; of many, as
    many as `coverage` looks at, scattered, as cameras may take turns. The saving is measured if
    meters read of all cameras what their slots are charged with.

    Args:
        connection: to the store.
        start_ns: first time.
        end_ns: last time.
        active_w: by camera, what an active one draws, for one that was active in no slot.
        where: the store, for errors.
    """
    runs, slots = schema.runs.c, schema.slots.c
    known = {column["name"] for column in inspect(connection).get_columns("slots")}
    blind: Any = slots.blind if "blind" in known else null()
    unseen = and_(slots.selected.contains("1"), ~slots.arrived.contains("1"))  # of a store of old
    inside = slots.time_ns.between(start_ns, end_ns)
    count = connection.scalar(select(func.count()).select_from(schema.slots).where(inside)) or 0
    share = min(SLOTS_LOOKED_AT / max(count, 1), 1.0)
    asked = (
        select(slots.run_id, slots.selected, slots.energy_j, func.count().label("slots"))
        .where(inside, slots.slot * SCATTER % RANGE < round(share * RANGE))
        .where(slots.energy_j.is_not(None))
        .where(or_(blind == "", and_(blind.is_(None), ~unseen)))
        .group_by(slots.run_id, slots.selected, slots.energy_j)
    )
    groups = connection.execute(asked).all()
    spent_j, always_j, seconds = 0.0, 0.0, 0.0
    for run in connection.execute(select(runs.run_id, runs.cameras, runs.interval_ns)).all():
        cameras, interval_s = json.loads(run.cameras), run.interval_ns / 1e9
        rows = [row for row in groups if row.run_id == run.run_id]
        if not rows:
            continue
        place = f"{where}: slots: run {run.run_id}: energy_j"
        shape = (len(cameras),)
        charged_j = stack_blobs([row.energy_j for row in rows], "<f4", shape, place)
        selected = np.array([[flag == "1" for flag in row.selected] for row in rows])
        active_j = interval_s * np.array([active_w.get(camera, np.nan) for camera in cameras])
        counts = np.array([row.slots for row in rows]) / share
        sums = charged(selected, charged_j.astype(np.float64), active_j, counts)
        spent_j, always_j = spent_j + sums[0].sum(), always_j + sums[1].sum()
        seconds += float(counts.sum()) * interval_s
    read = spent(connection, start_ns, end_ns)
    read_w = sum(one.energy_j / one.span_s for one in read if one.span_s)
    metered = (
        seconds > 0
        and {one.camera_id for one in read if one.measured > MEASURED} >= set(active_w)
        and abs(spent_j / seconds - read_w) <= METERED * read_w
    )
    return saving(spent_j, always_j, metered)


def stays(connection: Connection, start_ns: int, end_ns: int) -> list[StoredStay]:
    """Return the stays in zones of all who were there between two times, also before them.

    Args:
        connection: to the store.
        start_ns: first time.
        end_ns: last time.
    """
    if not inspect(connection).has_table("zones"):
        return []  # a store of an earlier version
    tracks, zones = schema.tracks.c, schema.zones.c
    there = connection.execute(
        select(tracks.run_id, tracks.track_id, tracks.first_ns).where(
            tracks.last_ns >= start_ns, tracks.first_ns <= end_ns
        )
    ).all()
    if not there:
        return []
    asked = (
        select(zones.run_id, zones.track_id, zones.zone, zones.kind, zones.time_ns)
        .where(zones.run_id.in_({row.run_id for row in there}))
        .where(zones.time_ns.between(min(row.first_ns for row in there), end_ns))
        .where(zones.kind.in_(("enter", "leave")))
        .order_by(zones.time_ns)
    )
    wanted = {(row.run_id, row.track_id) for row in there}
    entered: dict[tuple[int, int, str], int] = {}
    found = []
    for run_id, track_id, zone, kind, time_ns in connection.execute(asked):
        if (run_id, track_id) not in wanted:
            continue
        key = run_id, track_id, zone
        if kind == "enter":
            entered[key] = time_ns
        elif key in entered:
            found.append(StoredStay(*key, entered.pop(key), time_ns))
    return found + [StoredStay(*key, since_ns, None) for key, since_ns in entered.items()]
