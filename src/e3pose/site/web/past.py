"""States of people in stored slots, as on the live page.

Postures and speeds are not stored: they are found again from the stored poses, by the rules that
the live page uses. Zones are those that were stored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from e3pose.events.body import joints_of
from e3pose.events.watch import Watch, advance
from e3pose.site.connect import LiveSlot
from e3pose.site.stored import stored_slots
from e3pose.site.web.postures import posture, unsure_parts
from e3pose.store import Store, StoredPoses
from e3pose.store.overview import StoredStay

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
            watch, of_run = None if live is None else _again(live, slot.joints), run
        if watch is not None:
            watch, _ = advance(watch, slot)
        if slot.time_ns >= first_ns:
            made |= _of_slot(run, slot, watch, since_ns, stays)
    return made


def _again(live: Watch, joints: tuple[str, ...]) -> Watch:
    """Return a watch before the first slot; stored events are not reported again."""
    return replace(
        live,
        joints=joints_of(joints),
        rules={},
        memories={},
        known={},
        shown={},
        slot=-1,
        time_ns=0,
    )


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
