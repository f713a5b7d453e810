"""A copy of a store holds what the store held, on either kind of database."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import select
from tests.cli.commands import run as run_cli
from tests.postgres import Server
from tests.store.conftest import STARTED_NS, record, run
from tests.store.test_versions import old, tables
from tests.store.writers import QUICK, stored_slots

from e3pose.base.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.store import EnergyReading, Event, Store, StoreWriter, schema
from e3pose.store.copying import copy_store
from e3pose.store.database import database_url, writing_engine

__all__ = ["old"]  # a fixture
Place = Path | str


@pytest.fixture(params=["sqlite", "postgresql"])
def dest(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    if request.param == "sqlite":
        return tmp_path / "copy.db"
    server: Server = request.getfixturevalue("postgres")
    return server.new_store()


def fill(place: Place, slots: int = 30) -> None:
    for site in ("hall", "yard"):
        with StoreWriter(place, run(site), QUICK) as writer:
            for slot in range(slots):
                writer.append(record(slot), wait=True)
            writer.event(Event(STARTED_NS, "start", "begun"))
            writer.energy(EnergyReading(STARTED_NS, "north", 1.0, 1.0, "measured"))
            writer.zone(ZoneEvent("enter", "door", 10, 1, 0.0, 3, STARTED_NS))


def rows(place: Place) -> dict[str, list[tuple[object, ...]]]:
    with writing_engine(database_url(place)).connect() as connection:
        return {
            table.name: [tuple(r) for r in connection.execute(select(table).order_by(*table.c))]
            for table in (schema.runs, *schema.ROWS.values())
        }


def test_copy_holds_every_row(place: Place, dest: Place) -> None:
    fill(place)
    with StoreWriter(place, run("hall", 5), QUICK):  # the source is in use
        counts = copy_store(place, dest, lambda *_: None)
    before, after = rows(place), rows(dest)
    before["runs"] = [r for r in before["runs"] if r in after["runs"]]
    assert before == after
    assert counts == {name: len(content) for name, content in after.items()}
    assert tables(dest)["poses"][1] == ["run_id", "slot", "track_id", "time_ns"]
    with StoreWriter(dest, run("attic"), QUICK) as writer:  # the next run has a number of its own
        writer.append(record(0))
    assert len({one.run_id for one in Store(dest).runs()}) == 3


def test_copy_of_an_old_version_has_the_present_one(old: Place, dest: Place) -> None:
    copy_store(old, dest, lambda *_: None)
    assert len(Store(dest).query()) == len(Store(old).query()) > 0
    assert Store(dest).rows("zones") == []
    assert tables(dest)["slots"][1] == ["run_id", "slot", "time_ns"]


def test_copy_is_of_one_moment(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    with StoreWriter(path, run(), QUICK) as writer:
        for slot in range(50):
            writer.append(record(slot), wait=True)
        assert writer.flush()

        def write_on(*_: object) -> None:
            writer.append(record(writer.status().acknowledged_slot + 1), wait=True)
            assert writer.flush()

        copy_store(path, tmp_path / "copy.db", write_on)
        assert writer.status().acknowledged_slot > 50
    assert stored_slots(tmp_path / "copy.db") == list(range(50))
    assert len(Store(tmp_path / "copy.db").query()) == 100


def test_what_is_there_is_never_written_over(place: Place, dest: Place) -> None:
    fill(place, 2)
    copy_store(place, dest, lambda *_: None)
    before = rows(dest)
    with pytest.raises(InputError, match=r"found a file, expected|found runs in it, expected"):
        copy_store(place, dest, lambda *_: None)
    assert rows(dest) == before


def test_copy_that_fails_leaves_nothing(tmp_path: Path) -> None:
    fill(tmp_path / "live.db", 5)

    def stumble(table: str, *_: object) -> None:
        if table == "poses":
            raise RuntimeError("stumbled")

    with pytest.raises(RuntimeError, match="stumbled"):
        copy_store(tmp_path / "live.db", tmp_path / "copy.db", stumble)
    assert not [p.name for p in tmp_path.iterdir() if not p.name.startswith("live.db")]


def test_command_says_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path / "live.db", 5)
    words = ["store", "copy", str(tmp_path / "live.db"), str(tmp_path / "backup.db")]
    assert run_cli(*words) == 0
    message = f"Wrote {tmp_path / 'backup.db'}: 2 runs, 10 slots, 20 poses"
    assert capsys.readouterr().out.strip() == message
    assert (tmp_path / "backup.db").stat().st_mode & 0o777 == 0o600
    assert run_cli(*words) == 2
    assert run_cli("store", "copy", str(tmp_path / "none.db"), str(tmp_path / "x.db")) == 2
    assert not (tmp_path / "x.db").exists()
    assert all(len(line) > 0 for line in capsys.readouterr().err.strip().splitlines())


@pytest.mark.nightly  # two databases more
def test_tools_of_postgresql_back_up_and_restore(postgres: Server, tmp_path: Path) -> None:
    """As the guide says, into another database."""
    source, back = (postgres.new_database() for _ in range(2))
    fill(source)
    dump = tmp_path / "lab.dump"
    done = postgres.run("pg_dump", "--format=custom", source)
    dump.write_bytes(done.stdout)
    postgres.run("pg_restore", "--dbname", back, str(dump))
    assert rows(back) == rows(source)
