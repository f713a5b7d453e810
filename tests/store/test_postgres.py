"""A store on a PostgreSQL server: that goes away, refuses, is shared, and has a password."""

from __future__ import annotations

import threading

import pytest
from sqlalchemy import text
from tests.cases import each_case
from tests.postgres import Server
from tests.store.conftest import record, run
from tests.store.writers import QUICK, stored_slots, wait_for

from e3pose.base.errors import InputError
from e3pose.store import Event, Retention, Store, StoreWriter, WriterSettings, schema
from e3pose.store.database import check_place, database_url, reading, shown, writing_engine

SECRET = "hunter2"


@pytest.fixture
def url(postgres: Server) -> str:
    return postgres.new_store()


def test_refusal_of_the_server_is_not_held_against_the_rows(url: str) -> None:
    """A right that was taken away is trouble that ends, as a full disk is."""
    events: list[Event] = []
    with StoreWriter(url, run(), QUICK, report=events.append) as writer:
        writer.append(record(0))
        assert writer.flush()
        engine = writing_engine(database_url(url))
        with engine.begin() as connection:
            connection.execute(text("ALTER TABLE slots RENAME TO hidden"))
            connection.execute(text("CREATE VIEW slots AS SELECT 1 AS none"))
        writer.append(record(1))
        assert writer.flush()
        assert writer.status().problem is not None
        assert writer.status().shed == 0
        with engine.begin() as connection:
            connection.execute(text("DROP VIEW slots"))
            connection.execute(text("ALTER TABLE hidden RENAME TO slots"))
        wait_for(lambda: writer.status().problem is None)
    assert stored_slots(url) == [0, 1]
    assert [e.kind for e in events] == ["store-trouble", "store-recovered"]


def test_row_that_the_server_cannot_hold_is_refused_alone(url: str) -> None:
    with StoreWriter(url, run(), QUICK) as writer:
        writer.append(record(0))
        writer.event(Event(5, "said", "nul \0 is no text for PostgreSQL"))
        writer.event(Event(6, "said", "half a pair \ud800"))
        writer.append(record(1))
        assert writer.flush()
        assert writer.status().problem is None
    assert stored_slots(url) == [0, 1]
    kinds = {row["kind"] for row in Store(url).rows("events", 0)}
    assert "store-refused" in kinds and "said" not in kinds


def test_writers_that_begin_together_make_one_store(url: str) -> None:
    def write(site: str) -> None:
        with StoreWriter(url, run(site), QUICK) as writer:
            for slot in range(20):
                writer.append(record(slot), wait=True)

    threads = [threading.Thread(target=write, args=(f"site{i}",)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(Store(url).runs()) == 4
    assert len(stored_slots(url)) == 80
    with writing_engine(database_url(url)).connect() as connection:
        assert connection.execute(text("SELECT version FROM e3pose_store")).all() == [
            (schema.VERSION,)
        ]


def test_tables_may_be_partitioned_by_time(url: str) -> None:
    """As TimescaleDB does: what partitions by the time wants it in every unique key."""
    with StoreWriter(url, run()):
        pass
    with writing_engine(database_url(url)).begin() as connection:
        for name in ("slots", "poses", "energy", "events", "zones"):
            connection.execute(text(f"ALTER TABLE {name} RENAME TO plain"))
            made = f"CREATE TABLE {name} (LIKE plain INCLUDING ALL) PARTITION BY RANGE (time_ns)"
            connection.execute(text(made))
            connection.execute(text(f"CREATE TABLE {name}_all PARTITION OF {name} DEFAULT"))
            connection.execute(text("DROP TABLE plain"))
    with StoreWriter(url, run(), QUICK) as writer:
        for slot in [*range(30), *range(20)]:
            writer.append(record(slot), wait=True)
    assert stored_slots(url) == list(range(30))
    assert len(Store(url).query("0.4", "0.8")) == 2 * 11


def test_reader_cannot_write_and_sees_one_state(url: str) -> None:
    with StoreWriter(url, run(), QUICK) as writer:
        writer.append(record(0))
        assert writer.flush()
        with reading(url) as connection:
            asked = text("SELECT count(*) FROM slots")
            assert connection.execute(asked).scalar() == 1
            writer.append(record(1))
            assert writer.flush()
            assert connection.execute(asked).scalar() == 1, "of one question"
        with pytest.raises(InputError, match="read-only"), reading(url) as connection:
            connection.execute(text("DELETE FROM slots"))
    assert stored_slots(url) == [0, 1]


@each_case(
    "with_password",
    [
        f"postgresql://me:{SECRET}@nowhere.invalid/lab",
        f"postgresql://me@nowhere.invalid/lab?password={SECRET}",
        f"postgresql://me:{SECRET}@nowhere.invalid:port/lab",
        f"postgres://me:{SECRET}@/lab?host=/nowhere",
    ],
)
def test_password_is_in_no_message(with_password: str) -> None:
    events: list[Event] = []
    said = []
    try:
        said.append(shown(with_password))
        with StoreWriter(with_password, run(), QUICK, report=events.append) as writer:
            said.append(writer.status().problem or "")
    except InputError as error:
        said.append(str(error))
    with pytest.raises(InputError) as refused:
        Store(with_password).query()
    said += [str(refused.value), *(event.message for event in events)]
    assert len(said) > 1
    assert not any(SECRET in line for line in said), said


def test_missing_driver_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> None:
        raise ModuleNotFoundError("No module named 'psycopg'", name="psycopg")

    monkeypatch.setattr("e3pose.store.database.create_engine", missing)
    with pytest.raises(InputError, match=r"no driver psycopg, .* pip install '\S+\[postgres\]'"):
        check_place("postgresql://me@here/lab")


def test_other_kinds_of_database_are_refused() -> None:
    with pytest.raises(InputError, match=r"\*\*\*@here/lab: found mysql, expected a file or postg"):
        Store(f"mysql://me:{SECRET}@here/lab").query()


def test_size_of_a_server_is_not_ours_to_keep(url: str) -> None:
    settings = WriterSettings(retention=Retention(max_bytes=10**9))
    with pytest.raises(InputError, match="max_size: found with a database server"):
        StoreWriter(url, run(), settings)
