"""A hub has every summary of every site once, whoever is killed, away, hostile or full."""

from __future__ import annotations

import datetime
import json
import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.cli.commands import run as run_verb
from tests.hub.site import fill
from tests.live.processes import as_root
from tests.live.test_full_disk import fill as fill_disk
from tests.ports import free_port
from tests.postgres import Server
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.wire.codec import decode, encode
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.site_messages import OutboxPart, OutboxQuestion
from e3pose_hub.database import cursor_of, open_hub, read_rows
from e3pose_hub.pull import pull, wait_s
from e3pose_hub.settings import load_hub

pytestmark = pytest.mark.slow

SITE = Path(__file__).parent / "site.py"
ROOT = Path(__file__).parents[2]
E3POSE = [sys.executable, "-c", "from e3pose.cli import main; main()"]


def numbers(database: Path, site: str) -> list[int]:
    """Return which minutes of a site a hub has."""
    try:
        with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
            asked = "SELECT (time_ns - 1795000020000000000) / 60000000000 FROM summaries"
            where = " WHERE site = ? ORDER BY time_ns"
            return [row[0] for row in connection.execute(asked + where, (site,))]
    except sqlite3.Error:
        return []


@contextmanager
def program(*words: str) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline()
            yield process
        finally:
            process.kill()


def serve(
    name: str, port: int, store: Path, keys: str = "", host: str = "127.0.0.1"
) -> AbstractContextManager[subprocess.Popen[str]]:
    kind = "tls" if keys else "tcp"
    words = [sys.executable, str(SITE), name, f"{kind}/{host}:{port}", str(store)]
    return program(*words, *([keys] if keys else []))


def hub_file(folder: Path, ports: dict[str, int], kind: str = "tcp", more: str = "") -> Path:
    lines = ['format = "e3pose-hub"', "version = 1", "every_s = 1", more]
    for name, port in ports.items():
        host = "localhost" if kind == "tls" else "127.0.0.1"
        lines += ["[[site]]", f'name = "{name}"', f'endpoint = "{kind}/{host}:{port}"']
    path = folder / "hub.toml"
    path.write_text("\n".join(lines))
    return path


def test_hub_and_sites_are_killed_and_everything_is_there_once(tmp_path: Path) -> None:
    ports = {name: free_port() for name in ("lab", "hall")}
    for name in ports:
        fill(tmp_path / f"{name}.db", name, 0, 350)
    hub, database = hub_file(tmp_path, ports), tmp_path / "hub.db"
    with serve("lab", ports["lab"], tmp_path / "lab.db"):
        with serve("hall", ports["hall"], tmp_path / "hall.db") as hall:
            with program(*E3POSE, "hub", "run", str(hub)) as running:
                assert eventually(lambda: len(numbers(database, "lab")) >= 100, 60)
                running.send_signal(signal.SIGKILL)  # in the middle
            hall.send_signal(signal.SIGKILL)
        assert 0 < len(numbers(database, "lab")) < 350
        fill(tmp_path / "hall.db", "hall", 350, 10)  # meanwhile
        with program(*E3POSE, "hub", "run", str(hub)):
            assert eventually(lambda: len(numbers(database, "lab")) == 350, 60)
            with serve("hall", ports["hall"], tmp_path / "hall.db"):
                assert eventually(lambda: len(numbers(database, "hall")) == 360, 90)
    assert numbers(database, "lab") == [*range(350)]
    assert numbers(database, "hall") == [*range(360)]
    rows = read_rows(str(database), "sites")[1]
    assert [(row[0], *row[2:4]) for row in rows] == [("hall", 360, 0), ("lab", 350, 0)]


def test_hub_s_certificate_fetches_and_others_do_not(tmp_path: Path) -> None:
    now, port = datetime.datetime.now(datetime.timezone.utc), free_port()
    init_keys(tmp_path / "keys", "lab", [], now)
    add_keys(tmp_path / "keys", "house", now, kind="hub")
    init_keys(tmp_path / "other", "lab", [], now)
    add_keys(tmp_path / "other", "house", now, kind="hub")
    fill(tmp_path / "lab.db", "lab", 0, 3)
    hub, database = hub_file(tmp_path, {"lab": port}, "tls"), tmp_path / "hub.db"
    with serve("lab", port, tmp_path / "lab.db", str(tmp_path / "keys")):
        (tmp_path / "lab").symlink_to(tmp_path / "other" / "hubs" / "house")
        with program(*E3POSE, "hub", "run", str(hub)) as running:
            assert running.stdout is not None and "no connection to" in running.stdout.readline()
        assert numbers(database, "lab") == []
        (tmp_path / "lab").unlink()
        (tmp_path / "lab").symlink_to(tmp_path / "keys" / "hubs" / "house")
        with program(*E3POSE, "hub", "run", str(hub)):
            assert eventually(lambda: numbers(database, "lab") == [0, 1, 2], 60)


def test_site_whose_certificate_is_missing_keeps_no_other_from_being_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_port()
    fill(tmp_path / "lab.db", "lab", 0, 3)
    lost = '[[site]]\nname = "hall"\nendpoint = "tls/localhost:9"\n'
    hub = hub_file(tmp_path, {"lab": port})
    hub.write_text(f"{hub.read_text()}\n{lost}")
    with serve("lab", port, tmp_path / "lab.db"), program(*E3POSE, "hub", "run", str(hub)) as run:
        assert eventually(lambda: numbers(tmp_path / "hub.db", "lab") == [0, 1, 2], 30)
        assert run.stdout is not None
        assert re.match("hall: .*authority.pem: file not found", run.stdout.readline())
    hub.write_text(f'format = "e3pose-hub"\nversion = 1\n{lost}')
    assert run_verb("hub", "run", hub) == 2  # nobody is left
    assert "authority.pem: file not found" in capsys.readouterr().err


def test_full_disk_at_the_hub_is_told_and_nothing_is_lost(tmp_path: Path) -> None:
    port, disk = free_port(), tmp_path / "disk"
    fill(tmp_path / "lab.db", "lab", 0, 1500)
    disk.mkdir()
    as_root("mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(disk))
    try:
        hub = hub_file(disk, {"lab": port})
        with (
            serve("lab", port, tmp_path / "lab.db"),
            program(*E3POSE, "hub", "run", str(hub)) as running,
        ):
            assert running.stdout is not None
            assert eventually(lambda: len(numbers(disk / "hub.db", "lab")) >= 100, 30)
            fill_disk(disk / "filler")
            line = running.stdout.readline()
            assert "lab: database:" in line and "full" in line
            (disk / "filler").unlink()
            assert running.stdout.readline() == "lab: answers again\n"
            assert eventually(lambda: numbers(disk / "hub.db", "lab") == [*range(1500)], 60)
    finally:
        subprocess.run(["umount", "-l", str(disk)], capture_output=True, check=False)


def answers(store: Path, site: str = "lab") -> OutboxAnswers:
    clock = iter(range(10**6))
    return OutboxAnswers(store, site, now_s=lambda: float(next(clock)))


def fetch(tmp_path: Path, store: Path, engine: object = None) -> int:
    engine = engine or open_hub(str(tmp_path / "hub.db"))
    box = answers(store)
    return pull(engine, "lab", lambda q: box.answer("e3pose/lab/outbox/hub", q), lambda: None, 1)  # type: ignore[arg-type]


def test_hub_keeps_them_in_either_database(tmp_path: Path, postgres: Server) -> None:
    fill(tmp_path / "lab.db", "lab", 0, 250)
    for database in (str(tmp_path / "hub.db"), postgres.new_hub()):
        engine = open_hub(database)
        assert fetch(tmp_path, tmp_path / "lab.db", engine) == 250
        assert fetch(tmp_path, tmp_path / "lab.db", engine) == 0
        names, rows = read_rows(database, "summaries")
        assert names[:3] == ["site", "started_ns", "time_ns"] and len(rows) == 250


def test_what_a_site_shed_is_counted_and_another_outbox_begins_anew(tmp_path: Path) -> None:
    fill(tmp_path / "lab.db", "lab", 0, 5)
    with sqlite3.connect(tmp_path / "lab.db") as connection:
        connection.execute("DELETE FROM summaries WHERE number <= 2")
    engine = open_hub(str(tmp_path / "hub.db"))
    assert fetch(tmp_path, tmp_path / "lab.db", engine) == 3
    fill(tmp_path / "new.db", "lab", 5, 2)  # the store was replaced
    assert fetch(tmp_path, tmp_path / "new.db", engine) == 2
    with engine.connect() as connected:
        cursor = cursor_of(connected, "lab")
    assert (cursor.taken, cursor.lost) == (2, 2)
    assert numbers(tmp_path / "hub.db", "lab") == [2, 3, 4, 5, 6]


def test_hostile_site_is_refused_and_harms_nobody(tmp_path: Path) -> None:
    fill(tmp_path / "lab.db", "lab", 0, 3)
    engine = open_hub(str(tmp_path / "hub.db"))
    good = answers(tmp_path / "lab.db").answer("e3pose/lab/outbox/hub", encode(OutboxQuestion()))
    assert good is not None
    (row, *_) = json.loads(decode(good, OutboxPart, "lab").rows)
    draw = random.Random(1)
    bad = [
        b"", b"\x00" * 100, encode(OutboxQuestion()), encode(OutboxPart(1, 5, 0, b"{")),
        *(
            encode(OutboxPart(1, 5, 0, json.dumps([{**row, **change}]).encode()))
            for change in (
                {"number": 0}, {"number": 9}, {"slots": -1}, {"zones": {"x": "y"}}, {"span_s": 1e9},
                {"version": 2}, {"faults": ["x"] * 201}, {"software": "x" * 501},
                {"time_ns": 2**63},
            )
        ),
        encode(OutboxPart(1, 5, 0, json.dumps([row, row]).encode())),
        *(bytes(draw.randrange(256) for _ in range(200)) for _ in range(50)),
    ]  # fmt: skip
    for content in bad:
        with pytest.raises(InputError):
            pull(engine, "evil", lambda _, c=content: c, lambda: None, 1)  # type: ignore[misc]
    assert numbers(tmp_path / "hub.db", "evil") == []
    assert fetch(tmp_path, tmp_path / "lab.db", engine) == 3


def test_who_asks_too_often_gets_nothing_and_others_do(tmp_path: Path) -> None:
    fill(tmp_path / "lab.db", "lab", 0, 1)
    now = [0.0]
    box = OutboxAnswers(tmp_path / "lab.db", "lab", now_s=lambda: now[0])
    question = encode(OutboxQuestion())
    assert box.answer("e3pose/lab/outbox/a", question) is not None
    assert box.answer("e3pose/lab/outbox/a", question) is None
    assert box.answer("e3pose/lab/outbox/b", question) is not None
    now[0] = 0.3
    assert box.answer("e3pose/lab/outbox/a", question) is not None


def test_waits_grow_with_failures_are_bounded_and_differ() -> None:
    assert wait_s(60, 0, 0.5) == 60
    assert [wait_s(60, failures, 0.5) for failures in (1, 2, 5, 9)] == [15, 30, 240, 960]
    assert wait_s(60, 0, 0.0) == 30 and wait_s(60, 0, 0.999) < 90


HEAD = 'format = "e3pose-hub"\nversion = 1\n'


@each_case(
    ("text", "message"),
    [
        ("", "^[^:]*hub.toml: missing: format"),
        ('format = "e3pose-site"\nversion = 1', "format: found .*expected .e3pose-hub"),
        (f"{HEAD}sites = 1", "unknown key 'sites'"),
        (f"{HEAD}every_s = 0", "every_s"),
        (f'{HEAD}[view]\nkey = "a.pem"', "view: .*expected both"),
        (f'{HEAD}[view]\nlisten = "x"', "listen: .*expected HOST:PORT"),
        (f'{HEAD}[[site]]\nname = "a/b"\nendpoint = "x"', "site"),
        (f'{HEAD}[[site]]\nname = "a"\nendpoint = "x"', "endpoint"),
        (
            f'{HEAD}[[site]]\nname = "a"\nendpoint = "tls/a:1"\npage = "ftp://x"',
            r"site\[0\]\.page: found 'ftp://x', expected an address",
        ),
    ],
)
def test_wrong_file_of_a_hub_is_told(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=r"^[^:]*nohub: found no such file, expected the file of"):
        load_hub(tmp_path / "nohub")
    (tmp_path / "hub.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_hub(tmp_path)


def test_damaged_database_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hub = hub_file(tmp_path, {"lab": 7447})
    (tmp_path / "hub.db").write_bytes(b"something else" * 100)
    for words in (("query", hub, "sites"), ("accesses", hub)):
        assert run_verb("hub", *words) == 2
        assert capsys.readouterr().err.startswith(f"e3pose: {tmp_path / 'hub.db'}: ")


def test_server_that_is_away_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hub = hub_file(tmp_path, {"lab": 7447})
    hub.write_text(f'database = "postgresql://nobody@127.0.0.1:1/none"\n{hub.read_text()}')
    for words in (("run", hub), ("forgotten", hub), ("accesses", hub), ("query", hub, "sites")):
        assert run_verb("hub", *words) == 2
        assert "postgresql://nobody@127.0.0.1:1/none: cannot be used" in capsys.readouterr().err


def test_store_of_a_site_is_no_hub(tmp_path: Path) -> None:
    fill(tmp_path / "lab.db", "lab", 0, 1)
    with pytest.raises(InputError, match="expected those of a hub"):
        open_hub(str(tmp_path / "lab.db"))
