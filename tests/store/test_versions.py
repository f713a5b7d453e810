"""Stores of earlier versions are read as they are and upgraded by a writer; newer ones refused."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import inspect, text, update
from tests.cli.commands import refused
from tests.store.conftest import STARTED_NS, record, run

from e3pose.base.errors import InputError
from e3pose.store import EnergyReading, Event, Store, StoreWriter, migrations, schema
from e3pose.store.database import database_url, writing_engine
from e3pose.store.people import kept_of
from e3pose.store.rows import energy_row, event_row, slot_rows
from e3pose.store.saver import Delivery, known

Place = Path | str
SLOTS = 40
OF_PEOPLE = {"track_id", "zone", "phase", "start_ns", "score"}
LATER = {"slots": {"blind"}, "poses": {"dynamics"}, "events": OF_PEOPLE}  # columns since
SCHEMAS = Path(__file__).parent / "schemas"


@pytest.fixture
def old(place: Place, monkeypatch: pytest.MonkeyPatch) -> Place:
    """A store of version 1: tables by the SQL of that time, rows as its writer wrote them."""
    engine = writing_engine(database_url(place))
    statements = (SCHEMAS / f"1.{engine.dialect.name}.sql").read_text().split(";\n")
    with engine.begin() as connection:
        for statement in statements[:-1]:
            connection.exec_driver_sql(statement)
        connection.execute(text("INSERT INTO e3pose_store (version) VALUES (1)"))
    rows = [r for s in range(SLOTS) for r in slot_rows(record(s), STARTED_NS + s * 40_000_000)]
    rows.append(event_row(Event(STARTED_NS, "start", "begun"), 1))
    rows = [(n, {k: r[k] for k in r if k not in LATER.get(n, ())}) for n, r in rows]
    rows.append(energy_row(EnergyReading(STARTED_NS, "north", 1.0, 1.0, "measured")))
    monkeypatch.setattr("e3pose.store.saver.prepare", lambda *_: 1)
    delivery = Delivery(database_url(place))
    assert delivery.commit(rows, run()) == 0
    delivery.close()
    monkeypatch.undo()
    return place


def tables(place: Place) -> dict[str, Any]:
    """Return columns, keys and indexes of every table."""
    engine = writing_engine(database_url(place))
    with engine.connect() as connection:
        seen = inspect(connection)
        return {
            name: (
                [(c["name"], str(c["type"]), c["nullable"]) for c in seen.get_columns(name)],
                seen.get_pk_constraint(name)["constrained_columns"],
                [(i["name"], i["column_names"]) for i in seen.get_indexes(name)],
            )
            for name in sorted(seen.get_table_names())
        }


def version(place: Place) -> int:
    with writing_engine(database_url(place)).connect() as connection:
        return int(connection.execute(text("SELECT version FROM e3pose_store")).scalar_one())


def test_store_of_version_1_is_read_as_it_is(old: Place) -> None:
    assert len(Store(old).query()) == 2 * SLOTS
    rows = Store(old).rows("slots")
    assert len(rows) == SLOTS and all(row["blind"] is None for row in rows)
    assert Store(old).rows("zones") == []
    kept = {"poses": SLOTS, "tracks": 1, "events": 0, "zones": 0}
    assert kept_of(old, ((1, 10),)) == kept, "events had no track, zones no table"
    assert version(old) == 1 and Store(old).runs()[0].run.own_skeleton == ""


def test_writer_upgrades_a_store_of_version_1(
    old: Place, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    before, reported = Store(old).query(), list[Event]()
    with StoreWriter(old, run(), report=reported.append) as writer:
        writer.append(record(SLOTS), wait=True)
        writer.append(record(5), wait=True)  # is there already
    assert version(old) == schema.VERSION
    assert [e.kind for e in reported] == ["store-upgraded"]
    assert reported[0].message.endswith(f"upgraded from schema 1 to {schema.VERSION}")
    with StoreWriter(old, run(), report=reported.append):
        assert len(reported) == 1, "once"
    after = Store(old).query()
    assert after.slots.tolist() == sorted([*range(SLOTS + 1)] * 2)
    np.testing.assert_array_equal(after.time_ns[:-2], before.time_ns)
    for name in ("joints_m", "scores", "sigma_m", "measured", "track_ids"):
        kept = getattr(after.people, name)[:-2]
        np.testing.assert_array_equal(kept, getattr(before.people, name))
    assert [row["kind"] for row in Store(old).rows("events")] == ["start", "store-upgraded"]
    assert len(Store(old).rows("energy")) == 1
    new: Place = tmp_path / "new.db"
    if isinstance(old, str):
        new = request.getfixturevalue("postgres").new_store()
    with StoreWriter(new, run()):
        pass
    assert tables(old) == tables(new), "an upgraded store is what a new one is"


def test_upgrade_that_fails_leaves_the_store_as_it_was(
    old: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = tables(old)

    def stumble(connection: Any) -> None:
        migrations._to_2(connection)
        connection.execute(text("SELECT * FROM what_is_not_there"))

    monkeypatch.setitem(migrations.STEPS, 2, stumble)
    with StoreWriter(old, run()) as writer:
        problem = writer.status().problem
    assert problem is not None and "what_is_not_there" in problem
    assert tables(old) == before
    assert len(Store(old).query()) == 2 * SLOTS


KILLED = """
import os, signal, sys
from e3pose.store import migrations
from e3pose.store.forgetting import changing

step = migrations.STEPS[int(sys.argv[2])]

def killed(connection):
    step(connection)
    os.kill(os.getpid(), signal.SIGKILL)

migrations.STEPS[int(sys.argv[2])] = killed
with changing(sys.argv[1]):
    pass
"""


@pytest.mark.parametrize("step", [2, schema.VERSION // 2, schema.VERSION])
def test_upgrade_that_is_killed_loses_nothing(old: Place, step: int) -> None:
    words = [sys.executable, "-c", KILLED, str(old), str(step)]
    assert subprocess.run(words, check=False).returncode == -signal.SIGKILL
    assert version(old) == 1 and len(Store(old).query()) == 2 * SLOTS
    with StoreWriter(old, run()) as writer:
        writer.append(record(SLOTS), wait=True)
    assert version(old) == schema.VERSION
    assert Store(old).query().slots.tolist() == sorted([*range(SLOTS + 1)] * 2)


def test_upgrade_without_room_is_refused(old: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    if isinstance(old, str):
        pytest.skip("the disk of a server is not ours")
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(1, 1, 10))
    said = rf"from schema 1 to {schema.VERSION}: found 0\.00 GB of free disk space"
    with pytest.raises(InputError, match=said):
        StoreWriter(old, run())
    assert version(old) == 1


def test_newer_version_is_refused_and_untouched(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    with StoreWriter(place, run()) as writer:
        writer.append(record(0))
    with writing_engine(database_url(place)).begin() as connection:
        connection.execute(update(schema.about).values(version=schema.VERSION + 1))
    before = tables(place), place.read_bytes() if isinstance(place, Path) else b""
    for use in (lambda: StoreWriter(place, run()), lambda: Store(place).query()):
        with pytest.raises(InputError, match=r"version: found 14, expected 1 to 13; read it with"):
            use()
    refused(capsys, "query", place)
    assert (tables(place), place.read_bytes() if isinstance(place, Path) else b"") == before


def test_every_step_is_there_and_every_growing_table_has_the_time_in_its_key() -> None:
    assert sorted(migrations.STEPS) == list(range(2, schema.VERSION + 1))
    assert schema.READABLE[-1] == schema.VERSION
    for name, table in schema.ROWS.items():
        keys = {column.name for column in table.primary_key}
        assert "time_ns" in keys or name == "tracks", name


def test_rows_that_an_earlier_version_spooled_are_delivered() -> None:
    rows = slot_rows(record(0), STARTED_NS)
    earlier = [
        (name, {k: row[k] for k in row if k not in LATER.get(name, ())}) for name, row in rows
    ]
    found = known([*earlier, ("slots", {"slot": 1}), ("other", {}), *rows])
    later = [(n, {**r, **dict.fromkeys(LATER[n])}) for n, r in earlier]
    assert found == [*later, *rows]
