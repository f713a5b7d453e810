"""Hostile sites and viewers of a hub: nobody else notices, at night across processes."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import httpx
import msgspec
import psutil
import pytest
from sqlalchemy import text
from tests.hub.site import fill
from tests.hub.test_hub import E3POSE, hub_file, numbers, program, serve
from tests.manual_clock import ManualClock
from tests.ports import free_port
from tests.waiting import commands_below, eventually

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.store.summaries import MINUTE_NS
from e3pose.wire.codec import encode
from e3pose.wire.keys.authority import make_authority, make_certificate
from e3pose.wire.site_messages import OutboxPart
from e3pose_hub import accesses
from e3pose_hub import pull as pulling
from e3pose_hub.accesses import log_accesses, read_accesses
from e3pose_hub.database import Cursor, hours, keep, open_hub, read_rows, summaries
from e3pose_hub.page import open_page
from e3pose_hub.pull import AT_ONCE, Outcome, Turn, pull
from e3pose_hub.settings import load_hub
from e3pose_hub.users import grant
from simulated_sites import records_of

pytestmark = pytest.mark.slow

HOSTILE = Path(__file__).parent / "hostile_site.py"
HABITS = ("slow", "slow", "endless", "large", "deaf", "junk")
LATEST_S = 60.0  # a minute comes before the next one is there
WATCHED_S = 30.0


@pytest.mark.nightly  # half a minute of twenty programs
def test_as_many_hostile_sites_as_are_asked_at_once_keep_no_other_waiting(tmp_path: Path) -> None:
    bad = {f"evil{at}": HABITS[at % len(HABITS)] for at in range(AT_ONCE + 8)}
    ports = {name: free_port() for name in ("lab", "hall", *bad)}
    hub, database = hub_file(tmp_path, ports), tmp_path / "hub.db"
    came_s, minute = list[float](), 3
    with ExitStack() as stack:
        for name in ("lab", "hall"):
            fill(tmp_path / f"{name}.db", name, 0, 3)
            stack.enter_context(serve(name, ports[name], tmp_path / f"{name}.db"))
        for name, habit in bad.items():
            endpoint = f"tcp/127.0.0.1:{ports[name]}"
            stack.enter_context(program(sys.executable, str(HOSTILE), name, endpoint, habit))
        stack.enter_context(program(*E3POSE, "hub", "run", str(hub)))

        def has(count: int) -> bool:
            return all(len(numbers(database, name)) == count for name in ("lab", "hall"))

        end_s = time.monotonic() + WATCHED_S
        while time.monotonic() < end_s or not came_s:
            begun_s = time.monotonic()
            assert eventually(partial(has, minute), LATEST_S), sorted(came_s)
            came_s.append(time.monotonic() - begun_s)
            for name in ("lab", "hall"):
                fill(tmp_path / f"{name}.db", name, minute, 1)
            minute += 1
    print(f"a minute {max(came_s):.1f} s at most, {len(came_s)} times")
    told = {row[0]: row[-1] for row in read_rows(str(database), "sites")[1]}
    assert told["lab"] == told["hall"] == ""
    assert all(told[name] for name, habit in bad.items() if habit in ("deaf", "junk"))


def test_more_hostile_sites_than_are_asked_at_once_keep_no_other_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each has always more, or is slow, or answers nothing, for as long as its turn may take."""
    outcomes = {f"evil{n}": each for n, each in enumerate([Outcome.MORE] * 6 + [Outcome.SLOW] * 2)}
    outcomes |= {"deaf": Outcome.FAILED, "lab": Outcome.WHOLE, "hall": Outcome.WHOLE}
    asked, now = (dict.fromkeys(outcomes, 0) for _ in range(2))

    def turn(_: pulling.Pulling, site: str) -> Outcome:
        asked[site] += 1
        now[site] += 1
        assert now[site] == 1 and sum(now.values()) <= 3
        if outcomes[site] is not Outcome.WHOLE:
            time.sleep(0.1)
        now[site] -= 1
        return outcomes[site]

    monkeypatch.setattr(pulling, "AT_ONCE", 3)
    monkeypatch.setattr("random.random", lambda: 0.5)
    monkeypatch.setattr(pulling.Pulling, "_pull", turn)
    hub = load_hub(hub_file(tmp_path, dict.fromkeys(outcomes, 9)))
    with pulling.Pulling(hub, open_hub(hub.database), lambda *_: None):
        assert eventually(lambda: min(asked["lab"], asked["hall"]) >= 6), asked
    assert max(asked["evil6"], asked["evil7"], asked["deaf"]) <= 6 < asked["evil0"], asked


def endless(size: int) -> bytes:
    return encode(OutboxPart(7, 10**6, 0, b"[]" + b" " * size))


def test_site_that_brings_too_much_is_refused_and_others_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pulling, "MOST_BYTES", 10_000)
    sizes, engine = Rate(1, 10_000, lambda: 0.0), open_hub(str(tmp_path / "hub.db"))
    with pytest.raises(InputError, match="evil: summaries: found more than"):
        for _ in range(20):
            pull(engine, "evil", lambda _: endless(900), lambda: None, 1, Turn("evil", sizes))
    assert pull(engine, "lab", lambda _: endless(900), lambda: None, 1, Turn("lab", sizes)) == 0


@pytest.mark.parametrize(
    ("each_s", "parts", "whole", "outcome"),
    [
        (0.3, 1, True, Outcome.WHOLE),
        (0.3, 30, False, Outcome.MORE),
        (9.0, 1, True, Outcome.SLOW),
        (9.0, 2, False, Outcome.SLOW),
    ],
)
def test_slow_sites_are_asked_less_often_and_long_turns_end(
    each_s: float, parts: int, whole: bool, outcome: Outcome
) -> None:
    clock = ManualClock()

    def seconds() -> float:
        return clock.now_ns() / 1e9

    turn = Turn("lab", Rate(1, 1e6, seconds), seconds)
    for _ in range(parts):
        clock.advance(each_s)
        turn.take(100)
    turn.whole = whole
    assert turn.outcome() is outcome
    clock.advance(pulling.TURN_S)
    assert turn.over()


FLOOD = Path(__file__).parents[1] / "flood.py"
MANY = 500  # sites that a page has to show, which answer nobody
FLOOD_S = 5.0
PATIENCE_S = 15.0  # for the page, on a machine that is busy: a browser asks so often
GROWN_MB = 200.0
ASK = """
import sys
from e3pose_hub.frames import query
print(0, flush=True)
while True:
    query(sys.argv[1], "hours")
"""


@dataclass
class House:
    """A hub of two sites that answer and many that are shown, at work in processes."""

    folder: Path
    url: str
    secure: str
    ports: dict[str, int]
    eve: str  # hostile
    bob: str


def crowd(folder: Path) -> None:
    """Keep a day of many sites."""
    engine = open_hub(str(folder / "hub.db"))
    now_ns = time.time_ns()
    begin_ns = now_ns - now_ns % MINUTE_NS - 1440 * MINUTE_NS
    rows = [
        msgspec.structs.replace(row, time_ns=begin_ns + at * MINUTE_NS)
        for at, row in enumerate(records_of(1, 0, 1440))
    ]
    keep(engine, "many0", rows, Cursor(1, 1440), now_ns)
    with engine.begin() as connection:
        for table, where in ((hours, ""), (summaries, f"AND time_ns > {now_ns - 5 * MINUTE_NS}")):
            others = ", ".join(c.name for c in table.columns if c.name != "site")
            for at in range(1, MANY):
                connection.execute(text(
                    f"INSERT INTO {table.name} (site, {others}) SELECT 'many{at}', {others} "
                    f"FROM {table.name} WHERE site = 'many0' {where}"
                ))  # fmt: skip
    engine.dispose()


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    ports = {name: free_port() for name in ("lab", "hall")}
    at, now = free_port(), datetime.datetime.now(datetime.timezone.utc)
    certificate, key = make_certificate(
        *make_authority("house", now), "hub", ["localhost", "127.0.0.1"], now
    )
    (tmp_path / "hub.pem").write_bytes(certificate)
    (tmp_path / "hub.key").write_bytes(key)
    sites = {**ports, **{f"many{number}": 9 for number in range(MANY)}}
    lines = ['format = "e3pose-hub"', "version = 1", "every_s = 1"]
    lines += ["[view]", f'listen = "127.0.0.1:{at}"', 'certificate = "hub.pem"', 'key = "hub.key"']
    for name, port in sites.items():
        lines += ["[[site]]", f'name = "{name}"', f'endpoint = "tcp/127.0.0.1:{port}"']
        lines += ['group = "all"', f'page = "https://{name}.local/"']
    shown = "\n".join(lines)
    (tmp_path / "hub.toml").write_text(shown)
    hub = load_hub(tmp_path)
    eve, bob = (grant(hub, name, "viewer", ("all",)) for name in ("eve", "bob"))
    crowd(tmp_path)
    # The hub that asks has the two that answer alone: the others are there to be shown.
    (tmp_path / "run").mkdir()
    alone = shown.partition('[[site]]\nname = "many0"')[0].replace(
        "every_s = 1", 'every_s = 1\ndatabase = "../hub.db"'
    )
    (tmp_path / "run" / "hub.toml").write_text(alone)
    with ExitStack() as stack:
        for name, port in ports.items():
            fill(tmp_path / f"{name}.db", name, 0, 3)
            stack.enter_context(serve(name, port, tmp_path / f"{name}.db"))
        stack.enter_context(program(*E3POSE, "hub", "run", str(tmp_path / "run")))
        stack.enter_context(program(*E3POSE, "hub", "view", str(tmp_path)))
        yield House(tmp_path, f"https://127.0.0.1:{at}", f"127.0.0.1:{at}", ports, eve, bob)


@pytest.mark.nightly  # a hub of five hundred sites
def test_flood_at_the_page_and_questions_without_a_pause_hurt_nobody_else(house: House) -> None:
    database = house.folder / "hub.db"
    head = {"Authorization": f"Bearer {house.bob}"}
    took_s, came_s, minute = list[float](), list[float](), 3

    def looks() -> None:
        with httpx.Client(verify=False, headers=head, timeout=PATIENCE_S) as one:
            begun_s = time.monotonic()
            found = one.get(f"{house.url}/api/sites")
            took_s.append(time.monotonic() - begun_s)
        assert found.status_code == 200 and len(found.json()["sites"]) == MANY + 2

    def has(count: int) -> bool:
        return len(numbers(database, "lab")) == count

    with httpx.Client(verify=False, headers=head, timeout=20) as one:
        assert one.post(f"{house.url}/api/open", json={"site": "lab"}).status_code == 200
    assert eventually(lambda: numbers(database, "hall") == [0, 1, 2], 30)
    (page,) = [
        p for p, command in commands_below(psutil.Process()).items() if command[-2:-1] == ["view"]
    ]
    before_mb = page.memory_info().rss / 1e6
    with ExitStack() as stack:
        stack.enter_context(program(sys.executable, str(FLOOD), house.secure, house.eve, "hall"))
        for _ in range(2):
            asks = program(sys.executable, "-c", ASK, str(house.folder))
            stack.enter_context(asks)
        end_s = time.monotonic() + FLOOD_S
        while time.monotonic() < end_s:
            fill(house.folder / "lab.db", "lab", minute, 1)
            minute, begun_s = minute + 1, time.monotonic()
            looks()
            assert eventually(partial(has, minute), 30)
            came_s.append(time.monotonic() - begun_s)
        assert page.memory_info().rss / 1e6 < before_mb + GROWN_MB
    print(f"page {max(took_s):.2f} s, a minute {max(came_s):.2f} s, {len(took_s)} times")
    looks()
    assert took_s[-1] < PATIENCE_S
    log = read_accesses(str(database), limit=10**6)
    assert sum(one.who == "bob" for one in log) == 1
    assert sum(one.who == "eve" for one in log) < 60


def test_who_opens_many_sites_is_slowed_down_and_others_are_not(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\n[[site]]\nname = "lab"\ngroup = "all"\n'
        'endpoint = "tcp/127.0.0.1:9"\npage = "https://lab.local/"\n'
    )
    hub = load_hub(tmp_path)
    eve, bob = (grant(hub, name, "viewer", ("all",)) for name in ("eve", "bob"))
    with open_page(hub, "127.0.0.1:0") as page:

        def opens(token: str) -> int:
            head = {"Authorization": f"Bearer {token}"}
            url = f"{page.url}api/open"
            return httpx.post(url, json={"site": "lab"}, headers=head, timeout=20).status_code

        found = [opens(eve) for _ in range(40)]
        assert found[0] == 200 and found.count(429) >= 5
        assert opens(bob) == 200
    log = read_accesses(hub.database, limit=100)
    assert [one.who for one in log] == ["bob", *["eve"] * found.count(200)]


def test_nobody_pushes_out_of_the_log_what_others_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accesses, "MOST", 10)
    monkeypatch.setattr(accesses, "SPARE", 5)
    engine = open_hub(str(tmp_path / "hub.db"))
    log_accesses(engine, "bob", ["lab", "hall"], "see")
    for number in range(40):
        log_accesses(engine, "eve", ["lab"], f"see {number}")
    found = read_accesses(str(tmp_path / "hub.db"))
    assert [one.who for one in found].count("bob") == 2
    assert 8 <= [one.who for one in found].count("eve") <= 13
    assert found[0].what == "see 39", "the newest stay"
    log_accesses(engine, "eve", ["lab"], "x" * 1000)
    assert read_accesses(str(tmp_path / "hub.db"))[0].what == "x" * 500
