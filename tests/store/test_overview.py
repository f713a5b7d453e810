"""Sums over hours that the database makes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.site.web.watched import FPS, RIG, STARTED_NS, record

import e3pose.store.overview as overview
from e3pose.model.skeleton import COCO17
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


def test_many_slots_are_estimated(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overview, "SLOTS_LOOKED_AT", 40)
    slots, _ = store.coverage(STARTED_NS, STARTED_NS + 4 * SECOND, 4)
    assert slots == pytest.approx([25, 25, 0, 25], abs=2)


def test_spent_joules_of_a_camera_with_what_was_measured(store: Store) -> None:
    (found,) = store.spent(STARTED_NS, STARTED_NS + 4 * SECOND)
    assert found == ("c0", 18.0, 4.0, 0.5), "video took part of the same time"
    assert store.spent(0, 1) == []
