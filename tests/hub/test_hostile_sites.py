"""Hostile sites and viewers of a hub: nobody else notices."""

from __future__ import annotations

import time
from pathlib import Path

import httpx
import pytest
from tests.hub.test_hub import hub_file
from tests.manual_clock import ManualClock
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import OutboxPart
from e3pose_hub import accesses
from e3pose_hub import pull as pulling
from e3pose_hub.accesses import log_accesses, read_accesses
from e3pose_hub.database import open_hub
from e3pose_hub.page import open_page
from e3pose_hub.pull import Outcome, Turn, pull
from e3pose_hub.settings import load_hub
from e3pose_hub.users import grant

pytestmark = pytest.mark.slow


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
