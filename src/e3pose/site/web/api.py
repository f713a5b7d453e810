"""The read-only part of the API: the site, its status, and its store.

Postures and speeds of people are not stored: they are found again from the stored poses, by the
rules that the live page uses. Zones are those that were stored.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import Response

from e3pose.base.errors import InputError
from e3pose.events.body import joints_of
from e3pose.events.watch import Watch, advance
from e3pose.model.region import in_rectangle, middles_m
from e3pose.output.report.scene import neck
from e3pose.site.connect import LiveSlot
from e3pose.site.stored import stored_slots
from e3pose.site.web.feed import Feed
from e3pose.site.web.postures import posture, unsure_parts
from e3pose.site.web.schemas import (
    PosePage,
    Refused,
    RowPage,
    as_json,
    people,
    slots_of_rows,
    status_body,
    status_schema,
)
from e3pose.store import Store, StoredPoses
from e3pose.store.overview import StoredStay

MAX_SLOTS, USUAL_SLOTS = 2000, 500  # in one answer
MAX_ROWS, USUAL_ROWS = 5000, 1000
NANOSECONDS = re.compile(r"[0-9]{16,19}")  # a time of day; fewer digits are seconds of a run
LARGEST = 2**63 - 1
REFUSALS: dict[int | str, dict[str, Any]] = {
    401: {"model": Refused, "description": "a token is needed, or wrong"},
    404: {"model": Refused, "description": "the site stores nothing"},
    422: {"model": Refused, "description": "what is asked for cannot be read or found"},
    429: {"model": Refused, "description": "too many requests"},
}
STATUS = {"content": {"application/json": {"schema": status_schema()}}}
TIME = (
    "such as `-10s`, `14:00`, `2026-11-21T14:00`, seconds of the newest run such as `12.5`, or "
    "nanoseconds since 1970"
)
Start = Annotated[str | None, Query(max_length=64, description=f"first time, {TIME}")]
End = Annotated[str | None, Query(max_length=64, description="last time, included")]
Run = Annotated[int | None, Query(ge=0, le=LARGEST, description="one run of the store only")]
Cursor = Annotated[str | None, Query(max_length=48, pattern=r"^[0-9]{1,18}(\.[0-9]{1,18})?$")]
T = TypeVar("T")


def make_api(
    feed: Feed, store: Store | None, describe: Callable[[str], dict[str, Any]]
) -> APIRouter:
    """Return the routes that only read.

    Args:
        feed: the newest of the site.
        store: of the site; None where nothing is stored.
        describe: what does not change, by the scope of a token: cameras, skeleton, room.
    """
    api = APIRouter(prefix="/api", responses=REFUSALS)

    @api.get("/site", summary="Cameras, skeleton, room and zones of the site")
    def site(request: Request) -> dict[str, Any]:
        return describe(getattr(request.state, "scope", "read"))

    @api.get("/status", summary="How the site is, by the second", responses={200: STATUS})
    def status() -> dict[str, Any]:
        if feed.status is None:
            raise HTTPException(404, "no status yet: the edge does not run, or just started")
        late = {"silent_s": feed.silent_s(), "smoothed_ms": feed.smoothed_ms()}
        said = [notice._asdict() for notice in feed.notices()]
        return {**status_body(feed.status), **late, "notices": said, **feed.called()}

    @api.get("/poses", summary="Stored poses", response_model=PosePage)
    def poses(
        start: Start = None,
        end: End = None,
        track: Annotated[int | None, Query(ge=-LARGEST, le=LARGEST)] = None,
        joint: Annotated[str | None, Query(max_length=64)] = None,
        region: Annotated[
            str | None, Query(max_length=120, description="x0,y0,x1,y1: corners on the floor, m")
        ] = None,
        run: Run = None,
        doing: Annotated[bool, Query(description="also what people did, as in live slots")] = False,
        limit: Annotated[int, Query(ge=1, le=MAX_SLOTS, description="slots")] = USUAL_SLOTS,
        cursor: Cursor = None,
    ) -> Response:
        if doing and joint is not None:
            raise HTTPException(422, f"doing: found with joint {joint!r}, expected whole bodies")
        corners = None if region is None else _corners(region)
        after = None if cursor is None else _pair(cursor)
        found = read_slots(needed(store), _time(start), _time(end), track, joint, run, after, limit)
        page = page_of(found, corners, limit)
        if doing:
            did = asked(lambda: doing_in(needed(store), found, feed.doing))
            for slot in page["slots"]:
                for person in slot["people"]:
                    person.update(did[slot["run"], slot["slot"], person["track"]])
        return encoded(page)

    @api.get("/runs", summary="Stored runs, oldest first")
    def runs() -> list[dict[str, Any]]:
        stored = asked(lambda: needed(store).runs())
        names = ("site", "name", "started_ns", "interval_s", "skeleton", "joints", "cameras")
        drawn = [{"limbs": one.run.limbed.limbs, "neck": neck(one.run.limbed)} for one in stored]
        return [{"run": one.run_id, **how} | {n: getattr(one.run, n) for n in names}
                for one, how in zip(stored, drawn, strict=True)]  # fmt: skip

    @api.get(
        "/{table}", summary="Stored slots, tracks, energy, events and zones", response_model=RowPage
    )
    def rows(
        table: Literal["slots", "tracks", "energy", "events", "zones"],
        start: Start = None,
        end: End = None,
        run: Run = None,
        limit: Annotated[int, Query(ge=1, le=MAX_ROWS, description="rows")] = USUAL_ROWS,
        cursor: Cursor = None,
    ) -> Response:
        offset = 0 if cursor is None else _pair(cursor)[0]
        found = asked(
            lambda: needed(store).rows(
                table, _time(start), _time(end), run=run, offset=offset, limit=limit + 1
            )
        )
        more = len(found) > limit
        # SQLAlchemy names columns by a text of its own kind.
        named = [{str(key): value for key, value in row.items()} for row in found[:limit]]
        return encoded({"rows": named, "cursor": str(offset + limit) if more else None})

    return api


def read_slots(
    store: Store,
    start: str | int | None,
    end: str | int | None,
    track: int | None,
    joint: str | None,
    run: int | None,
    after: tuple[int, int] | None,
    limit: int,
) -> list[StoredPoses]:
    """Return chunks of poses with up to `limit` slots and one more."""

    def read() -> list[StoredPoses]:
        chunks, seen = [], set[tuple[int, int]]()
        for chunk in store.read(
            start, end, track=track, joint=joint, run=run, after=after, chunk=max(256, 2 * limit)
        ):
            chunks.append(chunk)
            seen.update(zip(chunk.run_ids.tolist(), chunk.slots.tolist(), strict=True))
            if len(seen) > limit:
                break
        return chunks

    return asked(read)


def page_of(
    chunks: list[StoredPoses], corners: tuple[float, float, float, float] | None, limit: int
) -> dict[str, Any]:
    """Return chunks as `PosePage` describes them.

    Args:
        chunks: of poses, in order.
        corners: of the region; None for everywhere.
        limit: the most slots.
    """
    slots: list[dict[str, Any]] = []
    keys: list[tuple[int, int]] = []
    for chunk in chunks:
        keys += dict.fromkeys(zip(chunk.run_ids.tolist(), chunk.slots.tolist(), strict=True))
        here = np.ones(len(chunk), dtype=bool)
        if corners is not None:
            here = in_rectangle(middles_m(chunk.people.joints_m), corners)
        found = people(chunk.people[here])
        slots += slots_of_rows(chunk.run_ids[here], chunk.slots[here], chunk.time_ns[here], found)
    keys = list(dict.fromkeys(keys))
    merged: dict[tuple[int, int], dict[str, Any]] = {}
    for slot in slots:  # a slot may be in two chunks
        key = slot["run"], slot["slot"]
        if key in merged:
            merged[key]["people"] += slot["people"]
        else:
            merged[key] = slot
    last = keys[limit - 1] if len(keys) > limit else None
    shown = [merged[key] for key in keys[:limit] if key in merged]
    cursor = None if last is None else f"{last[0]}.{last[1]}"
    return {"joints": chunks[0].joints, "slots": shown, "cursor": cursor}


def encoded(body: dict[str, Any]) -> Response:
    """Return an answer as JSON, quickly; NaN is null."""
    return Response(as_json(body), media_type="application/json")


def needed(store: Store | None) -> Store:
    """Return a store; raise 404 where nothing is stored."""
    if store is None:
        raise HTTPException(404, "the site stores nothing: add [store] to its site file")
    return store


def asked(ask: Callable[[], T]) -> T:
    """Return the answer of a store query; raise 422 with the error of an invalid one."""
    try:
        return ask()
    except InputError as error:
        raise HTTPException(422, str(error.elsewhere())) from None


def _time(words: str | None) -> str | int | None:
    if words is None or not NANOSECONDS.fullmatch(words):
        return words
    return min(int(words), LARGEST)


def _pair(cursor: str) -> tuple[int, int]:
    first, _, second = cursor.partition(".")
    return int(first), int(second or 0)


def _corners(region: str) -> tuple[float, float, float, float]:
    try:
        x0, y0, x1, y1 = map(float, region.split(","))
    except ValueError:
        raise HTTPException(422, "region: expected x0,y0,x1,y1 in metres") from None
    if not np.isfinite([x0, y0, x1, y1]).all():
        raise HTTPException(422, "region: expected finite numbers")
    return x0, y0, x1, y1


BEFORE_S = 10.0  # of slots before those asked for: a posture takes seconds to be sure
MOST_BEFORE = 1000  # of these slots
Key = tuple[int, int, int]  # run, slot, track


def doing_in(
    store: Store, found: Sequence[StoredPoses], live: Watch | None
) -> dict[Key, dict[str, Any]]:
    """Return the state of each person of stored slots, by run, slot and track.

    Args:
        store: that they are of, with what came before them.
        found: the slots, in chunks, in order.
        live: what follows people on the live page; None where nobody does.
    """
    times = [(int(chunk.time_ns[0]), int(chunk.time_ns[-1])) for chunk in found if len(chunk)]
    if not times:
        return {}
    first_ns, last_ns = min(low for low, _ in times), max(high for _, high in times)
    since_ns = {
        (row["run_id"], row["track_id"]): row["first_ns"]
        for row in store.rows("tracks", first_ns, last_ns)
    }
    stays: dict[tuple[int, int], list[StoredStay]] = {}
    for stay in store.stays(first_ns, last_ns):
        stays.setdefault((stay.run_id, stay.track_id), []).append(stay)
    made: dict[Key, dict[str, Any]] = {}
    watch, of_run = None, -1
    for run, slot in stored_slots([*_before(store, first_ns), *found]):
        if run != of_run:
            watch, of_run = None, run
            if live is not None:  # before its first slot; stored events are not reported again
                watch = replace(
                    live, joints=joints_of(slot.joints), rules={}, memories={}, known={}, shown={},
                    slot=-1, time_ns=0,
                )  # fmt: skip
        if watch is not None:
            watch, _ = advance(watch, slot)
        if slot.time_ns >= first_ns:
            made |= _of_slot(run, slot, watch, since_ns, stays)
    return made


def _before(store: Store, first_ns: int) -> list[StoredPoses]:
    chunks, slots = [], set[int]()
    for chunk in store.read(first_ns - round(BEFORE_S * 1e9), first_ns - 1):
        chunks.append(chunk)
        slots.update(chunk.slots.tolist())
        if len(slots) > MOST_BEFORE:
            break
    return chunks


def _of_slot(
    run: int,
    slot: LiveSlot,
    watch: Watch | None,
    since_ns: Mapping[tuple[int, int], int],
    stays: Mapping[tuple[int, int], Sequence[StoredStay]],
) -> dict[Key, dict[str, Any]]:
    unsure = unsure_parts(slot)
    made: dict[Key, dict[str, Any]] = {}
    for row, track in enumerate(slot.people.track_ids.tolist()):
        inside = [
            {"name": stay.zone, "since_ns": stay.since_ns}
            for stay in stays.get((run, track), ())
            if stay.since_ns <= slot.time_ns
            and (stay.until_ns is None or slot.time_ns < stay.until_ns)
        ]
        does = {**posture(track, watch), "zones": inside, "unsure": unsure[row]}
        made[run, slot.slot, track] = {**does, "since_ns": since_ns.get((run, track))}
    return made
