"""A PostgreSQL server that hangs, holds locks, is killed; and the one writer of a site."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import text
from tests.cases import each_case
from tests.postgres import Server, running_server
from tests.store.conftest import record, run
from tests.store.writers import stored_slots, wait_for

from e3pose.base.errors import InputError
from e3pose.store import Event, Store, StoreWriter, WriterSettings
from e3pose.store.database import database_url, writing_engine
from e3pose.store.postgres import ANSWER_S, Line
from e3pose.store.spool import spools_of
from e3pose.store.timed_calls import TimedCalls

pytestmark = pytest.mark.slow
SITE = "hall"
CHILD = """
import sys, time
sys.path.insert(0, {tests!r})
from conftest import record, run
from e3pose.store import StoreWriter, WriterSettings
writer = StoreWriter({url!r}, run(), WriterSettings(commit_s=0.02, one_writer=True))
writer.append(record(0))
writer.flush()
print("has it", flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def server(postgres: Server) -> Iterator[Server]:
    """One that these tests may stop."""
    with running_server(postgres.tools) as made:
        yield made


def settings(folder: Path) -> WriterSettings:
    return WriterSettings(commit_s=0.02, spool_beside=folder / "lab", one_writer=True)


@contextmanager
def frozen(server: Server, url: str) -> Iterator[None]:
    server.freeze()
    try:
        yield
    finally:
        server.thaw()


@contextmanager
def locked(server: Server, url: str) -> Iterator[None]:
    """Hold the lock on a table that a person who repairs one holds."""
    with writing_engine(database_url(url)).connect() as connection:
        connection.execute(text("LOCK TABLE slots IN ACCESS EXCLUSIVE MODE"))
        yield
        connection.rollback()


@contextmanager
def killed(server: Server, url: str) -> Iterator[None]:
    server.kill()
    yield
    server.start()


@each_case("away", [frozen, locked, killed])
def test_nothing_is_lost_while_a_server_answers_nothing(
    server: Server, tmp_path: Path, away: Callable[..., object]
) -> None:
    url = server.new_store()
    events: list[Event] = []
    small = replace(settings(tmp_path), queue_slots=600)
    with StoreWriter(url, run(), small, report=events.append) as writer:
        for slot in range(20):
            writer.append(record(slot), wait=True)
        assert writer.flush()
        with away(server, url):  # type: ignore[attr-defined]
            begun_s, slot = time.monotonic(), 20
            while not events:
                assert writer.append(record(slot))
                slot += 1
                time.sleep(0.01)
                assert time.monotonic() - begun_s < 3 * ANSWER_S, "nobody was told"
            while slot < 1100:  # more than the queue holds
                slot += writer.append(record(slot), wait=True)
            assert writer.flush(), "the writer itself waits for nothing"
            status = writer.status()
            assert status.shed == 0 and status.problem
            assert status.acknowledged_slot == 19
            assert status.spooled > 3 * 1000
            (told,) = events
            assert told.kind == "store-trouble"
            assert "/postgres" in told.message, "names the store"
            assert str(tmp_path / "lab.spool-1") in told.message, "and what happens"
        wait_for(lambda: writer.status().problem is None, 60.0)
        assert writer.append(record(slot))
        assert writer.flush()
        assert writer.status().acknowledged_slot == slot
        assert writer.status().shed == 0
    assert [event.kind for event in events] == ["store-trouble", "store-recovered"]
    assert [row["kind"] for row in Store(url).rows("events")] == [event.kind for event in events]
    assert stored_slots(url) == list(range(slot + 1))
    assert len(Store(url).query()) == 2 * (slot + 1)
    assert spools_of(tmp_path / "lab") == []


def test_spool_is_delivered_in_order(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = server.new_store()
    with StoreWriter(url, run(), settings(tmp_path)) as writer:
        writer.append(record(0))
        assert writer.flush()
        committed: list[int] = []
        commit = writer._saver._delivery.commit

        def noted(rows: list[tuple[str, dict[str, int]]], of_run: object) -> int:
            done = commit(rows, of_run)  # type: ignore[arg-type]
            committed.extend(row["slot"] for table, row in rows if table == "slots")
            return done

        monkeypatch.setattr(writer._saver._delivery, "commit", noted)
        with locked(server, url):
            for slot in range(1, 600):
                writer.append(record(slot), wait=True)
            assert writer.flush()
        slot = 600
        while writer.status().problem is not None:
            writer.append(record(slot))
            slot += 1
            time.sleep(0.01)
    assert committed == list(range(1, slot))


def test_server_that_hangs_does_not_keep_an_edge_from_starting(
    server: Server, tmp_path: Path
) -> None:
    url = server.new_store()
    with StoreWriter(url, run(), settings(tmp_path)) as writer:
        writer.append(record(0))
    events: list[Event] = []
    with frozen(server, url):
        begun_s = time.monotonic()
        writer = StoreWriter(url, run(), settings(tmp_path), report=events.append)
        writer.append(record(1))
        assert writer.flush()
        assert time.monotonic() - begun_s < 4 * ANSWER_S
        assert [event.kind for event in events] == ["store-trouble"]
        assert writer.status().spooled
        begun_s = time.monotonic()
        writer.close(30.0)
        assert time.monotonic() - begun_s < 3 * ANSWER_S
    assert stored_slots(url) == [0]
    events.clear()
    other = StoreWriter(url, run("yard"), settings(tmp_path), report=events.append)
    with other:  # delivers what its spool has, under the run that it was of
        wait_for(lambda: any("recovered" in event.message for event in events))
    assert [row["slot"] for row in Store(url).rows("slots", site=SITE)] == [0, 1]
    assert spools_of(tmp_path / "lab") == []


def test_second_edge_of_a_site_is_refused(server: Server, tmp_path: Path) -> None:
    url = server.new_store()
    with StoreWriter(url, run(SITE), settings(tmp_path)):
        with pytest.raises(InputError, match=f"session .* writes site '{SITE}' there already") as e:
            StoreWriter(url, run(SITE), settings(tmp_path))
        assert "expected one edge per site: stop it" in str(e.value)
        with StoreWriter(url, run("yard"), settings(tmp_path)) as other:
            other.append(record(0))
            assert other.flush() and other.status().problem is None
        with StoreWriter(server.new_store(), run(SITE), settings(tmp_path)) as elsewhere:
            assert elsewhere.status().problem is None, "another schema is another store"
    with StoreWriter(url, run(SITE), settings(tmp_path)) as after:
        assert after.status().problem is None


def test_killed_edge_leaves_its_site_to_the_next(server: Server, tmp_path: Path) -> None:
    url = server.new_store()
    code = CHILD.format(tests=str(Path(__file__).parent), url=url)
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    with child.stdout:
        assert child.stdout.readline() == "has it\n"
        with pytest.raises(InputError, match="there already"):
            StoreWriter(url, run(SITE), settings(tmp_path))
        child.send_signal(signal.SIGKILL)
        child.wait()
    with StoreWriter(url, run(SITE), settings(tmp_path)) as writer:
        writer.append(record(1))
        assert writer.flush() and writer.status().problem is None
    assert stored_slots(url) == [0, 1]


def test_edge_takes_its_site_again_after_an_outage(server: Server, tmp_path: Path) -> None:
    url = server.new_store()
    with StoreWriter(url, run(SITE), settings(tmp_path)) as writer:
        server.stop()
        writer.append(record(0))
        assert writer.flush() and writer.status().problem
        server.start()
        wait_for(lambda: writer.status().problem is None)
        with pytest.raises(InputError, match="there already"):
            StoreWriter(url, run(SITE), settings(tmp_path))


def test_sessions_of_writers_have_deadlines_unless_the_url_says_otherwise(server: Server) -> None:
    url = server.new_store()
    for more, expected in (("", "3s"), ("%20-cstatement_timeout%3D7s", "7s")):
        engine = writing_engine(database_url(url + more))
        with engine.connect() as connection:
            asked = {
                name: connection.execute(text(f"SHOW {name}")).scalar()
                for name in ("statement_timeout", "lock_timeout")
            }
            connection.rollback()
            assert asked == {"statement_timeout": expected, "lock_timeout": "2s"}
        engine.dispose()


def test_call_that_hangs_is_given_up_and_cut() -> None:
    cut, caller_is_free = threading.Event(), threading.Event()
    caller = TimedCalls(0.1, cut.set)
    with pytest.raises(TimeoutError, match=r"no answer in 0\.1 s"):
        caller.call(caller_is_free.wait)  # type: ignore[arg-type]
    assert cut.is_set()
    called = threading.Event()
    with pytest.raises(TimeoutError, match="earlier call"):
        caller.call(called.set)
    assert not called.is_set(), "one at a time"
    caller_is_free.set()
    caller.call(called.set)
    assert called.is_set()
    cut.clear()
    with pytest.raises(TimeoutError):
        caller.call(lambda: time.sleep(0.3), patient=True)
    assert not cut.is_set()


def test_line_cuts_a_connection_that_waits(server: Server) -> None:
    engine = writing_engine(database_url(server.new_store()))
    line = Line(engine)
    with engine.connect() as connection:
        threading.Timer(0.3, line.cut).start()
        begun_s = time.monotonic()
        with frozen(server, ""), pytest.raises(Exception, match=r"closed|EOF|connection"):
            connection.execute(text("SELECT 1"))
        assert time.monotonic() - begun_s < 5.0
        connection.invalidate()
    line.close()
