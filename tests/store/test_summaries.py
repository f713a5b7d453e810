"""Minutes are summed up exactly, whatever comes late, twice or not at all."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from tests.store.conftest import CAMERAS, STARTED_NS, record

from e3pose.model.zone_event import ZoneEvent
from e3pose.store.rows import (
    NS,
    EnergyReading,
    Event,
    Presence,
    Row,
    energy_row,
    event_row,
    slot_rows,
    zone_row,
)
from e3pose.store.summaries import MINUTE_NS, Minutes

MINUTE = STARTED_NS - STARTED_NS % MINUTE_NS + MINUTE_NS  # a whole one on the clock


def minutes(now_ns: int = MINUTE - 1) -> Minutes:
    return Minutes("e3pose 1.0", CAMERAS, now_ns, {CAMERAS[-1]: "Küche"})


def of_slots(first: int, last: int, people: int = 2) -> list[Row]:
    """Return the rows of slots at 25 per second from the whole minute on."""
    return [
        row
        for slot in range(first, last)
        for row in slot_rows(record(slot, people), MINUTE + slot * 40_000_000)
    ]


def closed(summed: Minutes, now_ns: int, **options: bool) -> list[dict[str, Any]]:
    return [row for table, row in summed.closed(now_ns, **options) if table == "summaries"]


def test_minute_has_what_its_slots_had() -> None:
    summed = minutes()
    for first in range(0, 1500, 12):  # as commits bring them
        summed.take(of_slots(first, first + 12, people=2 if first < 744 else 4))
    assert closed(summed, MINUTE + 64 * NS) == [], "late rows may come"
    (found,) = closed(summed, MINUTE + 65 * NS)
    assert (found["time_ns"], found["span_s"], found["slots"]) == (MINUTE, 60.0, 1500)
    assert found["people"] == pytest.approx((744 * 2 + 756 * 4) / 1500, abs=1e-3)
    assert found["most_people"] == 4
    assert found["views"] == 1.0  # north arrives in every slot
    assert found["took_ms"] == pytest.approx(3.0)
    # The mean of the variances of three axes is a half; joint 3 has one, too.
    assert found["error_mm"] == pytest.approx(1e3 * np.sqrt(0.5), rel=1e-3)
    assert (found["software"], found["version"]) == ("e3pose 1.0", 1)


def test_counts_by_cause_kind_and_camera() -> None:
    summed = minutes()
    rows = of_slots(0, 3)
    rows[0][1]["blind"] = rows[3][1]["blind"] = "views-late"
    events = (
        Event(MINUTE + 1, "fall", "fell", track_id=3, phase="begun"),
        Event(MINUTE + 2, "lead", "raised"),
        Event(MINUTE + 3, "lead", "lowered"),
    )
    readings = (
        EnergyReading(MINUTE + 1, "north", 2.0, 1.0, "measured: VDD_IN", 0.5),
        EnergyReading(MINUTE + NS, "north", 3.0, 1.0, "measured: VDD_IN", 0.25),
        EnergyReading(MINUTE + NS + 1, "north", 1.0, 1.0, "recording"),
        EnergyReading(MINUTE + NS, "east", 4.0, 1.0, "modelled: xavier-nx"),
    )
    rows += [event_row(event, number) for number, event in enumerate(events)]
    summed.take([*rows, *map(energy_row, readings)])
    found = closed(summed, MINUTE + 65 * NS)[-1]
    assert json.loads(found["blind"]) == {"views-late": 2}
    assert json.loads(found["events"]) == {"fall begun": 1, "lead": 2}
    assert json.loads(found["joules"]) == {
        "east": {"modelled": 4.0},
        "north": {"measured": 5.0, "recording": 1.0},
    }
    assert json.loads(found["charge"]) == {"north": 0.25}


def test_charge_tells_what_an_hour_drains_of_a_battery_for_a_month() -> None:
    charges = []
    for share in (0.5, 0.5 - 1 / (30 * 24)):
        summed = minutes()
        reading = EnergyReading(MINUTE + 1, "north", 2.0, 1.0, "measured: VDD_IN", share)
        summed.take([*of_slots(0, 1), energy_row(reading)])
        charges.append(json.loads(closed(summed, MINUTE + 65 * NS)[-1]["charge"])["north"])
    assert charges[1] / (charges[0] - charges[1]) == pytest.approx(0.5 * 30 * 24 - 1, rel=0.01)


def test_time_in_zones_is_that_of_everybody_in_them_and_ends_with_what_is_known() -> None:
    summed = minutes()

    def zone(kind: Any, seconds: float, count: int) -> Row:
        return zone_row(ZoneEvent(kind, "door", 1, count, 0.0, 0, MINUTE + round(seconds * NS)))

    summed.take([zone("enter", 30, 1), zone("enter", 50, 2)])
    summed.take(of_slots(0, 1750))  # 70 s
    summed.take([zone("leave", 70, 1)])
    first = closed(summed, MINUTE + 66 * NS)[-1]
    assert json.loads(first["zones"]) == {"door": pytest.approx((20 + 2 * 10) / 60, abs=1e-4)}
    assert json.loads(first["entered"]) == {"door": 2}
    # Nobody looks from second 70 on: the one who stayed is not counted for the rest.
    second = closed(summed, MINUTE + 200 * NS)[0]
    assert json.loads(second["zones"]) == {"door": pytest.approx(2 * 10 / 60, abs=1e-2)}
    assert json.loads(second["entered"]) == {}


def test_states_are_person_minutes_without_gaps() -> None:
    summed = minutes()
    for tenth in range(300):
        summed.present(Presence(MINUTE + tenth * NS // 10, {"standing": 1.5, "lying": 0.5}))
    summed.present(Presence(MINUTE + 50 * NS, {"standing": 9.0}))  # 20 s later: not known
    found = closed(summed, MINUTE + 65 * NS)[-1]
    assert json.loads(found["states"]) == {
        "lying": pytest.approx(29.9 * 0.5 / 60, abs=1e-3),
        "standing": pytest.approx(29.9 * 1.5 / 60, abs=1e-3),
    }


def test_faults_stand_until_they_end() -> None:
    summed = minutes()

    def at(seconds: int, kind: str, camera: str | None = None) -> Row:
        return event_row(Event(MINUTE + seconds * NS, kind, "", camera), seconds)

    summed.take([at(1, "camera-back", "north"), at(2, "camera-back", "east")])
    summed.take([at(3, "camera-lost", "east"), at(4, "camera-back", "east"), at(5, "store-full")])
    faults = json.loads(closed(summed, MINUTE + 65 * NS)[-1]["faults"])
    assert faults == ["camera-lost Küche", "camera-lost east", "store-full"]
    summed.take([at(70, "store-recovered"), at(71, "camera-back", "south")])
    assert json.loads(closed(summed, MINUTE + 125 * NS)[-1]["faults"]) == ["store-full"][:0]


def test_rows_of_a_closed_minute_make_a_summary_of_their_own() -> None:
    summed = minutes()
    summed.take(of_slots(0, 100))
    whole = closed(summed, MINUTE + 65 * NS)[-1]
    summed.take(of_slots(100, 110))  # a clock that stepped back
    late = [row for row in closed(summed, MINUTE + 66 * NS) if row["slots"]]
    assert [row["slots"] for row in (whole, *late)] == [100, 10]
    assert late[0]["time_ns"] == MINUTE + 100 * 40_000_000 > whole["time_ns"]


def test_ending_closes_the_present_minute_and_a_beginning_is_none_before() -> None:
    summed = minutes(MINUTE + 10 * NS)
    summed.take(of_slots(250, 500))
    (found,) = closed(summed, MINUTE + 20 * NS, ending=True)
    assert (found["time_ns"], found["span_s"]) == (MINUTE + 10 * NS, 10.0)


def test_minute_without_slots_is_told() -> None:
    summed = minutes()
    summed.closed(MINUTE + NS)
    found = closed(summed, MINUTE + 65 * NS)[-1]
    assert (found["slots"], found["people"], found["error_mm"]) == (0, None, None)


def test_names_are_bounded() -> None:
    summed = minutes()
    summed.take(event_row(Event(MINUTE, f"kind{n}", ""), n) for n in range(1000))
    assert len(json.loads(closed(summed, MINUTE + 65 * NS)[-1]["events"])) == 200
