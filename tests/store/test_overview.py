"""Sums over hours that the database makes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.site.web.watched import FPS, RIG, STARTED_NS, record

import e3pose.store.overview as overview
from e3pose.model.skeleton import COCO17
from e3pose.model.zone_event import ZoneEvent
from e3pose.store import EnergyReading, Run, Store, StoreWriter

SECOND = 10**9


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    place = tmp_path_factory.mktemp("store") / "lab.db"
    run = Run("lab", "lab", STARTED_NS, 1 / FPS, "coco17", COCO17.joints, RIG.camera_ids)
    with StoreWriter(place, run) as writer:
        for slot in range(100):  # four seconds; the third is not there, the fourth is blind in part
            if 50 <= slot < 75:
                continue
            made = replace(record(slot), blind="orders-late" if slot >= 95 else "")
            writer.append(made, time_ns=STARTED_NS + round(slot / FPS * SECOND), wait=True)
        for second, source in enumerate(("measured: VDD_IN", "modelled", "recording")):
            reading = EnergyReading(STARTED_NS + second * SECOND, "c0", 6.0, 2.0, source)
            writer.energy(reading)
    return Store(place)


def test_parts_count_what_is_stored_and_what_is_blind(store: Store) -> None:
    slots, blind = store.coverage(STARTED_NS, STARTED_NS + 4 * SECOND, 4)
    assert slots == [25, 25, 0, 25] and blind == [0, 0, 0, 5]
    assert store.coverage(STARTED_NS - 9 * SECOND, STARTED_NS - SECOND, 2) == ([0, 0], [0, 0])


def test_every_slot_is_in_one_part_however_the_time_is_cut(store: Store) -> None:
    for parts in (1, 3, 7, 16, 1000):
        for end_ns in (STARTED_NS + 99 * SECOND // 25 + 1, STARTED_NS + 4 * SECOND + 13):
            slots, blind = store.coverage(STARTED_NS, end_ns, parts)
            assert (len(slots), sum(slots), sum(blind)) == (parts, 75, 5)
            half = [slot for slot in range(50) if slot / 100 < (parts // 2) / parts]
            assert sum(slots[: parts // 2]) == pytest.approx(len(half), abs=1)


def test_stays_are_those_of_everybody_who_was_there(tmp_path: Path) -> None:
    """The first comes and goes twice, the second stays, the third was there before."""
    place, visits = tmp_path / "lab.db", {1: (2, 4, 6, 8), 2: (3,), 3: (0, 1)}
    run = Run("lab", "lab", STARTED_NS, 1.0, "coco17", COCO17.joints, RIG.camera_ids)
    with StoreWriter(place, run) as writer:
        for slot in range(10):
            there = [track for track in visits if track < 3 or slot < 2]
            people = record(slot).people[np.zeros(len(there), dtype=int)]
            made = replace(record(slot), people=replace(people, track_ids=np.array(there)))
            writer.append(made, time_ns=STARTED_NS + slot * SECOND, wait=True)
        for track, times in visits.items():
            for turn, second in enumerate(times):
                kind: Any = ("enter", "leave")[turn % 2]
                at_ns = STARTED_NS + second * SECOND
                writer.zone(ZoneEvent(kind, "bed", track, 1, 0.0, second, at_ns))
                writer.zone(ZoneEvent("dwell", "bed", track, 1, 0.0, second, at_ns))

    def stays(first: int, last: int) -> list[tuple[int, int, int | None]]:
        found = Store(place).stays(STARTED_NS + first * SECOND, STARTED_NS + last * SECOND)
        assert {(stay.run_id, stay.zone) for stay in found} <= {(1, "bed")}
        since = [(s.since_ns - STARTED_NS) // SECOND for s in found]
        until = [s.until_ns and (s.until_ns - STARTED_NS) // SECOND for s in found]
        return sorted(zip([s.track_id for s in found], since, until, strict=True))

    assert stays(0, 9) == [(1, 2, 4), (1, 6, 8), (2, 3, None), (3, 0, 1)]
    assert stays(5, 7) == [(1, 2, 4), (1, 6, None), (2, 3, None)], "as known by then"
    assert stays(2, 2) == [(1, 2, None)]
    assert stays(20, 30) == []


def test_spent_joules_of_a_camera_with_what_was_measured(store: Store) -> None:
    (found,) = store.spent(STARTED_NS, STARTED_NS + 4 * SECOND)
    assert found == ("c0", 18.0, 4.0, 0.5), "video took part of the same time"
    assert store.spent(0, 1) == []
    assert store.saved(STARTED_NS, STARTED_NS + 4 * SECOND, ACTIVE_W) is None, "no joules of slots"


@pytest.fixture(scope="module")
def charged(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Slots in which cameras take turns, at 8 W active and 3 W idle; every tenth is blind."""
    place = tmp_path_factory.mktemp("charged") / "lab.db"
    run = Run("lab", "lab", STARTED_NS, 1 / FPS, "coco17", COCO17.joints, RIG.camera_ids)
    with StoreWriter(place, run) as writer:
        for slot in range(300):
            selected = np.arange(3) == slot % 3
            blind = "views-late" if slot % 10 == 9 else ""
            made = replace(record(slot), selected=selected & (not blind), blind=blind)
            joules = np.where(made.selected, 8.0, 3.0) / FPS
            at_ns = STARTED_NS + round(slot / FPS * SECOND)
            writer.append(made, time_ns=at_ns, energy_j=joules, wait=True)
        for camera in RIG.camera_ids:
            at_ns, read_j = STARTED_NS + 10 * SECOND, 10 * 14.0 / 3
            writer.energy(EnergyReading(at_ns, camera, read_j, 10.0, "measured: VDD_IN"))
    return Store(place)


ACTIVE_W = dict.fromkeys(RIG.camera_ids, 12.5)  # of a profile that is far off


def test_saving_is_against_active_slots_of_the_same_cameras(charged: Store) -> None:
    found = charged.saved(STARTED_NS, STARTED_NS + 20 * SECOND, ACTIVE_W)
    assert found is not None and found.basis == "measured"
    assert found.percent == pytest.approx(100 * (1 - 14 / 24), abs=1e-4)
    assert found.always == pytest.approx(270 / FPS * 24, rel=1e-5)
    early = charged.saved(STARTED_NS, STARTED_NS + 9 * SECOND, ACTIVE_W)  # before the readings
    assert early is not None and early.basis == "modelled"
    assert charged.saved(0, 1, ACTIVE_W) is None


def test_many_slots_are_estimated_though_cameras_take_turns(
    store: Store, charged: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overview, "SLOTS_LOOKED_AT", 40)
    slots, _ = store.coverage(STARTED_NS, STARTED_NS + 4 * SECOND, 4)
    assert slots == pytest.approx([25, 25, 0, 25], abs=2)
    monkeypatch.setattr(overview, "SLOTS_LOOKED_AT", 100)
    found = charged.saved(STARTED_NS, STARTED_NS + 20 * SECOND, ACTIVE_W)
    assert found is not None and found.percent == pytest.approx(100 * (1 - 14 / 24), abs=1)
    assert found.always == pytest.approx(270 / FPS * 24, rel=0.05)
    assert found.always != pytest.approx(270 / FPS * 24, rel=1e-6), "all slots were looked at"
