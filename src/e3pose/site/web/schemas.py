"""Schemas of the API's JSON and msgpack, and their conversion from arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import msgspec
import numpy as np
import orjson
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from e3pose.edge.reports import savings
from e3pose.events.watch import Watch
from e3pose.model.people import People
from e3pose.model.person_event import PersonEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.web.notices import Notice
from e3pose.site.web.postures import NOBODY, doing, told
from e3pose.site.zones import Zones
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus, Status

DECIMALS_M = 4  # a tenth of a millimetre
SLOT_FIELDS = (
    "slot", "time_ns", "published_ns", "joints", "selected", "arrived", "blind", "stored_from",
    "stored_to", "store_shed", "delay_ms",
)  # fmt: skip


class Shape(BaseModel):
    """A JSON object with these fields and no others."""

    model_config = ConfigDict(extra="forbid")


class Person(Shape):
    """One person in one slot: world metres, z up; null where a joint is unknown.

    What the person did is there where it is asked for.
    """

    track: int
    joints_m: list[list[float | None]]
    sigma_m: list[float | None]
    measured: list[bool]
    state: str | None = None
    probability: float | None = None
    speed_mps: float | None = None
    hips_m: float | None = None
    trunk_deg: float | None = None
    arms_raised: int | None = None
    since_ns: int | None = None
    zones: list[dict[str, Any]] = []
    unsure: list[str] = []


class Slot(Shape):
    """The people of one slot; `time_ns` is nanoseconds since 1970."""

    run: int
    slot: int
    time_ns: int
    people: list[Person]


class PosePage(Shape):
    """Slots in order; request the next ones with `cursor`, if there is one."""

    joints: list[str]
    slots: list[Slot]
    cursor: str | None


class RowPage(Shape):
    """Rows of a table of the store by column name."""

    rows: list[dict[str, Any]]
    cursor: str | None


class Refused(BaseModel):
    """Why a request was refused."""

    detail: Any


@dataclass(frozen=True, eq=False)
class Encoded:
    """An event of the live stream, encoded once for all followers.

    Attributes:
        kind: what it is.
        body: what JSON and msgpack hold alike.
    """

    kind: Literal["slot", "status", "zone", "edge", "told"]
    body: dict[str, Any]

    @cached_property
    def json(self) -> bytes:
        """As JSON."""
        return as_json({"type": self.kind, **self.body})

    @cached_property
    def msgpack(self) -> bytes:
        """As msgpack, which has NaN."""
        body = {"type": self.kind, **self.body}
        return msgspec.msgpack.encode(body, enc_hook=lambda array: array.tolist())

    @cached_property
    def sse(self) -> bytes:
        """As a server-sent event."""
        return b"event: " + self.kind.encode() + b"\ndata: " + self.json + b"\n\n"


def event_of_slot(
    slot: LiveSlot, zones: Zones, watch: Watch | None = None, since_ns: Mapping[int, int] = NOBODY
) -> Encoded:
    """Return the event of a slot that was published, with the people in each zone.

    Args:
        slot: which.
        zones: who is in which.
        watch: who does what; None where nobody follows it.
        since_ns: see `doing`.
    """
    found = people(slot.people)
    does = doing(slot, watch, zones, since_ns)
    who = [{**person, **state} for person, state in zip(found, does, strict=True)]
    body = {name: getattr(slot, name) for name in SLOT_FIELDS}
    return Encoded("slot", {**body, "people": who, "zones": zones.counts()})


def event_of_status(
    status: Status,
    smoothed_ms: float | None,
    notices: Sequence[Notice] = (),
    names: Mapping[str, Any] = MappingProxyType({}),
) -> Encoded:
    """Return the event of a status.

    Args:
        status: of the edge.
        smoothed_ms: delay of smoothed poses; None without them.
        notices: what is to be known of the site.
        names: the run of the store, and what its people are called.
    """
    more = {"smoothed_ms": smoothed_ms, "notices": [notice._asdict() for notice in notices]}
    return Encoded("status", {**status_body(status), **more, **names})


def event_of_told(events: Sequence[PersonEvent]) -> Encoded:
    """Return the message of people's events, oldest first."""
    return Encoded("told", {"events": [told(event) for event in events]})


def event_of_edge(there: bool, heard_ns: int | None) -> Encoded:
    """Return the event of an edge that is there or gone, and when it was last heard."""
    return Encoded("edge", {"there": there, "heard_ns": heard_ns})


def status_body(status: Status) -> dict[str, Any]:
    """Return a status by field name."""
    cameras = [msgspec.structs.asdict(camera) for camera in status.cameras]
    saved = asdict(savings(status))
    return {**msgspec.structs.asdict(status), "saved": saved, "cameras": cameras}


def status_schema() -> dict[str, Any]:
    """Return the JSON schema of `status_body`, each field with its meaning."""
    named = [(field.name, field.type) for field in msgspec.structs.fields(Status)]
    _, parts = msgspec.json.schema_components([msgspec.defstruct("Site", named), CameraStatus])
    for name, kind in (("Site", Status), ("CameraStatus", CameraStatus)):
        parts[name]["description"] = (kind.__doc__ or "").partition("\n")[0]
        for field in fields(kind):
            parts[name]["properties"][field.name]["description"] = field.meaning.replace(
                "None", "null"
            )
    site: dict[str, Any] = parts["Site"]
    site["properties"]["cameras"]["items"] = parts["CameraStatus"]
    return site


def people(found: People) -> list[dict[str, Any]]:
    """Return people as `Person` describes them, with arrays in place of lists."""
    places_m, errors_m = (
        m.astype(np.float64).round(DECIMALS_M) for m in (found.joints_m, found.sigma_m)
    )
    measured = np.ascontiguousarray(found.measured)
    columns = zip(found.track_ids.tolist(), places_m, errors_m, measured, strict=True)
    return [
        {"track": track, "joints_m": places, "sigma_m": errors, "measured": seen}
        for track, places, errors, seen in columns
    ]


def as_json(body: object) -> bytes:
    """Return lists, dicts and arrays as JSON; NaN is null.

    Arrays are written as they are: as lists they would take three times as long.
    """
    return orjson.dumps(body, option=orjson.OPT_SERIALIZE_NUMPY)


def slots_of_rows(
    run_ids: NDArray[np.int64],
    slots: NDArray[np.int64],
    time_ns: NDArray[np.int64],
    found: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Return rows of people as `Slot` describes them.

    Args:
        run_ids: `(num_rows,)` in order.
        slots: `(num_rows,)` in order within a run.
        time_ns: `(num_rows,)`.
        found: `(num_rows,)` people.
    """
    answer: list[dict[str, Any]] = []
    key: tuple[int, int] | None = None
    rows = zip(run_ids.tolist(), slots.tolist(), time_ns.tolist(), found, strict=True)
    for run_id, slot, at_ns, person in rows:
        if (run_id, slot) != key:
            key = (run_id, slot)
            answer.append({"run": run_id, "slot": slot, "time_ns": at_ns, "people": []})
        answer[-1]["people"].append(person)
    return answer
