"""What a store keeps comes back, by times as people write them."""

from __future__ import annotations

import csv
import json
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from sqlalchemy import update
from tests.cases import each_case
from tests.cli.commands import run as run_cli
from tests.store.conftest import KINDS, STARTED_NS, new_place, record, run

from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.model.zone_event import ZoneEvent
from e3pose.output.report.stored import charged_j, slot_records
from e3pose.store import EnergyReading, Event, Run, Store, StoreWriter, schema
from e3pose.store.database import database_url, writing_engine
from e3pose.store.times import as_when, iso_text, parse_when

BEGUN = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(microseconds=STARTED_NS // 1000)
NUM_SLOTS = 100
Place = Path | str


@pytest.fixture(scope="module", params=KINDS)
def filled(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A store for tests that only read."""
    return fill(new_place(request, tmp_path_factory.mktemp("filled")))


def fill(place: Place) -> Place:
    """Store four seconds of two people, an event, a meter's reading and somebody in a zone."""
    with StoreWriter(place, run()) as writer:
        for slot in range(NUM_SLOTS):
            spent_j = np.array([0.5, 0.25, 0.125]) * slot
            assert writer.append(record(slot), energy_j=spent_j, wait=True)
        writer.event(Event(STARTED_NS + 10**9, "camera-lost", "silent for 2 s", "east"))
        writer.energy(EnergyReading(STARTED_NS + 2 * 10**9, "north", 7.5, 1.5, "measured", 0.75))
        writer.zone(ZoneEvent("leave", "door", 11, 2, 1.5, 60, STARTED_NS + 24 * 10**8))
        assert writer.flush()
        status = writer.status()
    assert status.acknowledged_slot == NUM_SLOTS - 1
    assert (status.waiting, status.spooled, status.shed, status.problem) == (0, 0, 0, None)
    return place


def test_everything_comes_back(filled: Place) -> None:
    found = Store(filled).query()
    assert len(found) == NUM_SLOTS * 2
    assert found.joints == COCO17.joints
    assert found.people.joints_m.dtype == found.people.scores.dtype == np.float32
    for row in (0, 77, 199):
        slot, person = divmod(row, 2)
        truth = record(slot)
        assert found.slots[row] == slot
        assert found.people.track_ids[row] == 10 + person
        assert found.time_ns[row] == STARTED_NS + slot * 40_000_000
        np.testing.assert_array_equal(found.people.joints_m[row], truth.people.joints_m[person])
        np.testing.assert_array_equal(found.people.scores[row], truth.people.scores[person])
        np.testing.assert_allclose(found.people.sigma_m[row], np.full(17, 0.5**0.5), rtol=1e-3)
        np.testing.assert_array_equal(found.people.measured[row], truth.people.measured[person])
        assert truth.people.dynamics is not None and found.people.dynamics is not None
        np.testing.assert_allclose(
            found.people.dynamics[row], truth.people.dynamics[person], rtol=0.03
        )
    slots = Store(filled).rows("slots")
    assert len(slots) == NUM_SLOTS
    assert slots[8]["selected"] == "110"
    assert slots[8]["arrived"] == "100"
    assert slots[8]["next_selection"] == "001"
    assert slots[8]["occlusion"] == [0.25, 0.5, 8 / 1024]
    assert slots[8]["deficit"] == [1.5, 0.0, 2.0]
    assert slots[8]["energy_j"] == [4.0, 2.0, 1.0]
    assert slots[8]["took_s"] == pytest.approx(0.003)


def test_slots_come_back_as_the_records_that_they_were(filled: Place) -> None:
    store = Store(filled)
    rows, poses = store.rows("slots", "1", "2"), store.query("1", "2")
    found = slot_records(rows, poses, 0.04, first_slot=25)
    assert [made.slot for made in found] == [*range(26)]
    for made in found:
        truth = record(made.slot + 25)
        for name in ("selected", "arrived", "next_selection", "occlusion", "deficit"):
            np.testing.assert_array_equal(getattr(made, name), getattr(truth, name), name)
        np.testing.assert_array_equal(made.people.track_ids, truth.people.track_ids)
        np.testing.assert_array_equal(made.people.joints_m, truth.people.joints_m)
        assert made.people.joints_m.dtype == made.people.sigma_m.dtype == np.float64
        assert made.time_s == pytest.approx(0.04 * made.slot) and made.blind == ""
        assert made.stage_s == {"step": pytest.approx(0.003)}
    assert slot_records(rows, poses, 0.04)[0].slot == 25
    np.testing.assert_array_equal(charged_j(rows), [[s / 2, s / 4, s / 8] for s in range(25, 51)])
    assert charged_j([]) is None and charged_j([*rows, {**rows[0], "energy_j": None}]) is None
    causes = {("100", "100"): "", ("100", "000"): "views-missing", ("000", "000"): ""}
    for (selected, arrived), cause in causes.items():  # earlier versions did not store it
        old = {**rows[0], "selected": selected, "arrived": arrived, "blind": None}
        late = {**old, "blind": "views-late"}
        blind = [made.blind for made in slot_records([old, late], poses, 0.04)]
        assert blind == [cause, "views-late"]


def test_pages_of_rows_are_all_rows_once(place: Place) -> None:
    for part in range(3):
        with StoreWriter(place, run("hall", STARTED_NS + part * 10**12)) as writer:
            for slot in range(5 + part):
                writer.append(record(slot, num_persons=0), wait=True)
    store = Store(place)
    every = [(row["run_id"], row["slot"]) for row in store.rows("slots")]
    assert len(every) == len({*every}) == 18
    for size in (1, 4, 5, 7, 30):
        pages = [store.rows("slots", offset=at, limit=size) for at in range(0, 19, size)]
        assert [(row["run_id"], row["slot"]) for page in pages for row in page] == every
    second = store.runs()[1].run_id
    assert [row["slot"] for row in store.rows("slots", run=second, offset=4)] == [4, 5]
    with pytest.raises(InputError, match="table: found 'people', expected one of slots, tracks"):
        store.rows("people")


def test_events_and_readings_come_back(filled: Place) -> None:
    (event,) = Store(filled).rows("events")
    assert (event["kind"], event["camera_id"]) == ("camera-lost", "east")
    (reading,) = Store(filled).rows("energy")
    assert (reading["energy_j"], reading["span_s"], reading["charge"]) == (7.5, 1.5, 0.75)
    assert Store(filled).rows("energy", STARTED_NS + 3 * 10**9) == []
    (left,) = Store(filled).rows("zones", "2", "3")
    assert (left["zone"], left["kind"], left["track_id"]) == ("door", "leave", 11)
    assert (left["count"], left["stayed_s"], left["slot"]) == (2, 1.5, 60)


@each_case(
    ("start", "end", "slots"),
    [
        ("1", "1.08", [25, 26, 27]),
        ("3.92", None, [98, 99]),
        (None, "0s", [0]),
        (STARTED_NS + 40_000_001, STARTED_NS + 120_000_000, [2, 3]),
        ("9", "12", []),
        (BEGUN + timedelta(seconds=1), BEGUN + timedelta(seconds=1.04), [25, 26]),
    ],
)
def test_times_include_both_ends(filled: Place, start: Any, end: Any, slots: list[int]) -> None:
    assert np.unique(Store(filled).query(start, end).slots).tolist() == slots


def test_one_track_and_one_joint(filled: Place) -> None:
    found = Store(filled).query("1", "2", track=11, joint="left_wrist")
    assert found.joints == ("left_wrist",)
    assert found.people.track_ids.tolist() == [11] * 26
    np.testing.assert_array_equal(found.people.joints_m[:, 0, 0], np.arange(25, 51))
    assert (found.people.joints_m[:, 0, 1] == 1).all()
    assert (found.people.joints_m[:, 0, 2] == COCO17.index("left_wrist")).all()
    assert len(Store(filled).query(track=99)) == 0
    missing = Store(filled).query("0", "0.04", joint=COCO17.joints[3]).people
    assert np.isnan(missing.joints_m).all() and (missing.scores == 0).all()


def test_sites_and_runs_are_kept_apart(place: Place) -> None:
    with StoreWriter(place, run("hall")) as hall, StoreWriter(place, run("yard")) as yard:
        for slot in range(10):
            hall.append(record(slot, num_persons=1))
            yard.append(record(slot, num_persons=3))
    with StoreWriter(place, run("hall", STARTED_NS + 10**12)) as later:
        later.append(record(0, num_persons=2))
    store = Store(place)
    assert sorted(one.run.site for one in store.runs()) == ["hall", "hall", "yard"]
    assert len(store.query(site="hall")) == 10 + 2
    assert len(store.query(site="yard")) == 30
    assert len(store.query("0", "1")) == 2, "seconds are of the newest run"
    first = next(one.run_id for one in store.runs() if one.run.site == "hall")
    assert len(store.query("0", "1", run=first)) == 10
    with pytest.raises(InputError, match="expected one of hall, yard"):
        store.query(site="attic")


def test_a_restarted_program_goes_on_in_its_run(place: Place) -> None:
    for slots in (range(0, 20), range(15, 40)):
        with StoreWriter(place, run()) as writer:
            for slot in slots:
                writer.append(record(slot, num_persons=1))
    assert len(Store(place).runs()) == 1
    found = Store(place).query(track=10)
    assert found.slots.tolist() == list(range(40)), "once each"
    (track,) = Store(place).rows("tracks")
    assert (track["first_slot"], track["last_slot"]) == (0, 39)


def test_different_skeletons_are_named(place: Place) -> None:
    with StoreWriter(place, run()) as writer:
        writer.append(record(0))
    other = Run("hall", "b", 5, 0.04, "two", ("nose", "tail"), ("c",))
    with StoreWriter(place, other) as writer:
        writer.event(Event(6, "start", "begun"))
    with pytest.raises(InputError, match="run 1 has coco17 and run 2 has two"):
        Store(place).query()
    assert len(Store(place).query(joint="nose")) == 2
    assert len(Store(place).query(STARTED_NS, STARTED_NS + 10**9)) == 2, "of then one alone"
    with pytest.raises(InputError, match="nose, tail"):
        Store(place).query(joint="left_knee")


def test_what_is_damaged_is_named(place: Place) -> None:
    store, engine = Store(fill(place)), writing_engine(database_url(place))
    columns = ("joints_m", "scores", "sigma_m", "measured", "dynamics")
    damage = [("poses", {name: b"1234"}, f": run 1.*{name}: found 4 bytes") for name in columns]
    damage.append(("poses", {"scores": b"\0\x40" * 17}, r": .*scores: found one outside \[0, 1\]"))
    for name in ("occlusion", "deficit", "energy_j"):
        damage.append(("slots", {name: b"1234"}, f": run 1, slot .*{name}: found 4 bytes"))
    for slot, (table, values, said) in enumerate(damage):
        rows, when = schema.ROWS[table], f"{slot / 25:.2f}"
        with engine.begin() as connection:
            connection.execute(update(rows).where(rows.c.slot == slot).values(values))
        with pytest.raises(InputError, match=table + said):
            store.query(when, when) if table == "poses" else store.rows(table, when, when)
    assert len(store.query("1", "2")) == 52, "other times are still read"
    for joints in ("no JSON", "3", "[" * 100_000):
        with engine.begin() as connection:
            connection.execute(update(schema.runs).values(joints=joints))
        with pytest.raises(InputError, match="runs: run 1: joints and cameras are no lists"):
            store.runs()


def test_record_that_does_not_fit_is_refused_and_reported(place: Place) -> None:
    events: list[Event] = []
    with StoreWriter(place, run(), report=events.append) as writer:
        writer.append(record(0), energy_j=np.zeros(7))
        writer.append(record(1))
        writer.append(record(2), time_ns=2**70)
        writer.append(record(3))
        assert writer.flush()
        assert writer.status().shed == 1 + 3, "a record, and a slot with two people"
    assert np.unique(Store(place).query().slots).tolist() == [1, 3]
    assert any("energy" in event.message for event in events)
    kinds = {row["kind"] for row in Store(place).rows("events")}
    assert "store-refused" in kinds


def test_the_same_rows_are_written_in_every_format(filled: Place, tmp_path: Path) -> None:
    import pyarrow.compute
    from pyarrow import parquet

    names = {form: tmp_path / f"out.{form}" for form in ("csv", "parquet", "json")}
    who = ("--from", "1", "--to", "2", "--track", "11")
    for form in ("csv", "parquet"):
        assert run_cli("export", str(filled), str(names[form]), "--what", "poses", *who) == 0
    words = (*who, "--joint", "nose", "--json", str(names["json"]))
    assert run_cli("query", str(filled), *words) == 0
    every = list(csv.DictReader(names["csv"].read_text().splitlines()))
    assert {row["track"] for row in every} == {"11"} and len({row["joint"] for row in every}) > 1
    rows = [row for row in every if row["joint"] == "nose"]
    assert [row["slot"] for row in rows] == [str(slot) for slot in range(25, 51)]
    assert rows[0]["time"] == "2026-11-18T11:06:41.000000Z"
    listed = json.loads(names["json"].read_text())
    assert [row["x"] for row in listed] == list(range(25, 51))
    assert listed[0]["sigma"] == pytest.approx(0.5**0.5, rel=1e-3)
    assert listed[0]["measured"] is True
    whole = parquet.read_table(names["parquet"])
    table = whole.filter(pyarrow.compute.equal(whole.column("joint"), "nose"))
    assert table.column("time_ns").to_pylist() == [int(row["time_ns"]) for row in rows]
    assert str(table.schema.field("time").type) == "timestamp[ns, tz=UTC]"
    assert table.column("x").to_pylist() == list(range(25, 51))


@each_case(
    ("what", "count"),
    [("slots", NUM_SLOTS), ("tracks", 2), ("energy", 1), ("events", 1), ("zones", 1), ("runs", 1)],
)
def test_other_tables_are_written_too(filled: Place, tmp_path: Path, what: str, count: int) -> None:
    from pyarrow import parquet

    out = tmp_path / "out.parquet"
    assert run_cli("export", str(filled), str(out), "--what", what) == 0
    assert parquet.read_table(out).num_rows == count


def test_table_on_the_terminal(filled: Place, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("query", str(filled), "--from", "2", "--to", "2", "--joint", "nose") == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines[0].strip().endswith(", times in UTC")
    assert lines[1].split()[:5] == ["run", "slot", "time", "track", "joint"]
    assert len(lines) == 4
    assert run_cli("query", str(filled), "--from", "2", "--to", "3") == 0
    assert "first 40 rows" in capsys.readouterr().out
    assert run_cli("query", str(filled), "--from", "-10min") == 0
    assert "No matching rows" in capsys.readouterr().out


BERLIN = timezone(timedelta(hours=1))
NOW = datetime(2026, 11, 21, 14, 30, 0, tzinfo=BERLIN)


def utc_ns(*parts: int) -> int:
    return round(datetime(*parts, tzinfo=timezone.utc).timestamp()) * 10**9  # type: ignore[arg-type,misc]


@each_case(
    ("words", "expected"),
    [
        ("2026-11-21T14:00", utc_ns(2026, 11, 21, 13)),
        ("2026-11-21 14:00:05", utc_ns(2026, 11, 21, 13, 0, 5)),
        ("2026-11-21T13:00Z", utc_ns(2026, 11, 21, 13)),
        ("2026-11-21T13:00:00.25Z", utc_ns(2026, 11, 21, 13) + 250_000_000),
        ("2026-11-21T13:00:00-05:00", utc_ns(2026, 11, 21, 18)),
        ("2026-11-21", utc_ns(2026, 11, 20, 23)),
        ("14:00", utc_ns(2026, 11, 21, 13)),
        ("9:05:01", utc_ns(2026, 11, 21, 8, 5, 1)),
        ("now", utc_ns(2026, 11, 21, 13, 30)),
        ("-10min", utc_ns(2026, 11, 21, 13, 20)),
        ("-1.5h", utc_ns(2026, 11, 21, 12)),
        ("-2d", utc_ns(2026, 11, 19, 13, 30)),
        ("-30", utc_ns(2026, 11, 21, 13, 29, 30)),
    ],
)
def test_absolute_times(words: str, expected: int) -> None:
    when = parse_when(words, NOW, BERLIN)
    assert (when.origin, when.ns) == ("1970", expected)


@each_case(
    ("words", "seconds"), [("12.5", 12.5), ("90s", 90), ("5min", 300), ("0", 0), ("+2h", 7200)]
)
def test_seconds_of_a_run(words: str, seconds: float) -> None:
    when = parse_when(words, NOW, BERLIN)
    assert (when.origin, when.ns) == ("run", round(seconds * 10**9))
    assert when.absolute(1000) == 1000 + round(seconds * 10**9)


@each_case(
    "words", ["", "yesterday", "12 parsecs", "2026-13-01", "25:00", "9" * 40, "0001-01-01", "--5"]
)
def test_anything_else_is_refused(words: str) -> None:
    with pytest.raises(InputError, match="expected 2026-11-21T14:00"):
        parse_when(words, NOW, BERLIN)


def test_text_and_back_is_the_same_to_the_microsecond() -> None:
    summer = parse_when("2026-07-01T14:00", NOW, ZoneInfo("Europe/Berlin"))
    assert summer.ns == utc_ns(2026, 7, 1, 12), "the time of the day that is asked for"
    ns = 1_795_000_000_123_456_789
    assert iso_text(ns) == "2026-11-18T11:06:40.123456Z"
    assert as_when(iso_text(ns), NOW).ns == ns // 1000 * 1000
