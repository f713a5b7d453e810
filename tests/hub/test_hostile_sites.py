"""Hostile sites of a hub: no other site is asked later, and no disk is filled, across processes."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
from tests.hub.site import fill
from tests.hub.test_hub import E3POSE, hub_file, numbers, program, serve
from tests.manual_clock import ManualClock
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import OutboxPart
from e3pose_hub import pull as pulling
from e3pose_hub.database import open_hub, read_rows
from e3pose_hub.pull import AT_ONCE, Outcome, Turn, pull

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
