"""State that several threads share, while all of them use it as often as they can."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.edge.one_process import site_at_work
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.rigs import looking

from e3pose.edge.energy_ledger import UPDATE_S, EnergyLedger
from e3pose.edge.events import KEEP_EVENTS, EventLog
from e3pose.edge.gather import Gather
from e3pose.edge.inbox import Inbox
from e3pose.energy.budgets import Budget
from e3pose.energy.profiles import load_profile
from e3pose.site.web.feed import Feed
from e3pose.store.rows import Event, Run
from e3pose.store.writer import StoreWriter, WriterSettings

pytestmark = pytest.mark.slow

ROUNDS = 1000


class Slow(int):
    """A count during whose addition other threads run, as they may on any interpreter."""

    def __add__(self, other: int) -> Slow:
        total = int(self) + int(other)
        time.sleep(0)
        return Slow(total)


class SlowEvent:
    """An event of which other threads can run while it is read."""

    time_ns = 0

    @property
    def message(self) -> str:
        time.sleep(0)
        return "event"


@pytest.fixture(autouse=True)
def restless() -> Iterator[None]:
    """Let threads change as often as the interpreter can."""
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual_s)


def beside(*bodies: Callable[[int], object], rounds: int = ROUNDS) -> None:
    """Call functions on a thread each, many times; raise what one of them raised."""
    failures: list[BaseException] = []

    def work(body: Callable[[int], object]) -> None:
        try:
            for number in range(rounds):
                body(number)
                if failures:
                    return
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(body,), daemon=True) for body in bodies]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    if failures:
        raise failures[0]
    assert not any(thread.is_alive() for thread in threads)


def test_status_is_made_while_events_are_reported(tmp_path: Path) -> None:
    with site_at_work(tmp_path) as site:
        edge = site.edge
        over = threading.Event()

        def add(_: int) -> None:
            while not over.is_set():
                edge.event_log.add(SlowEvent())  # type: ignore[arg-type]

        def look(_: int) -> None:
            try:
                for _ in range(80):
                    edge.status()
            finally:
                over.set()

        beside(add, look, rounds=1)
        assert edge.threads.failure is None and edge.running()


class _Sink:
    def __init__(self) -> None:
        self.events: list[Event] = []

    def event(self, event: Event) -> bool:
        self.events.append(event)
        return True


def test_store_that_is_attached_gets_every_event_once() -> None:
    for _ in range(200):
        log, sink, begun = EventLog(ManualClock()), _Sink(), threading.Event()

        def report(number: int, log: EventLog = log, begun: threading.Event = begun) -> None:
            log.report("test", str(number))
            begun.set()

        def attach(log: EventLog = log, begun: threading.Event = begun, sink: _Sink = sink) -> None:
            begun.wait()
            log.attach(sink)  # type: ignore[arg-type]

        threads = [
            threading.Thread(target=lambda r=report: [r(i) for i in range(KEEP_EVENTS)]),
            threading.Thread(target=attach),
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [event.message for event in sink.events] == [str(i) for i in range(KEEP_EVENTS)]


class _Watched(EnergyLedger):
    """A ledger whose estimate is read and replaced under its lock alone."""

    @property
    def _estimated_ns(self) -> int | None:
        assert self._lock.locked()
        return self._ns

    @_estimated_ns.setter
    def _estimated_ns(self, ns: int | None) -> None:
        assert self._lock.locked() or not hasattr(self, "_ns")
        self._ns = ns


def test_budgets_change_while_slots_ask_for_them() -> None:
    profile, clock = load_profile("xavier-nx"), ManualClock()
    shares = [Budget("duty", 0.5)] * 2
    ledger = _Watched(
        ("c0", "c1"), [profile] * 2, ["power-saving"] * 2, shares, 0.04, 1.0, clock.now_ns
    )

    def estimate(_: int) -> None:
        estimate, _new = ledger.estimate()
        assert estimate.budget.shape == (2,)
        clock.time_ns += round(UPDATE_S * 1e9)

    beside(
        lambda i: ledger.change([Budget("duty", 0.25 + 0.5 * (i % 2))] * 2, 1.0),
        estimate,
        lambda i: ledger.charge(np.array([True, False])),
        rounds=500,
    )
    ledger.change(shares, 1.0)
    np.testing.assert_allclose(ledger.estimate()[0].budget, 0.5)


def test_every_message_that_is_not_read_is_counted() -> None:
    inbox = Inbox(
        "lab", looking((4, 0), (0, 4)), ("nose",), 0.05, Gather(2), ManualClock(10**9),
        lambda beat: None,
    )  # fmt: skip
    inbox.wrong = inbox.flooded = inbox.unknown_senders = Slow(0)
    hub = Hub()
    inbox.listen(hub.join())
    cameras = [hub.join() for _ in range(4)]

    def shout(what: str, index: int) -> Callable[[int], object]:
        topic = f"e3pose/lab/camera/{what}"
        return lambda i: cameras[index].publish(topic, b"garbage")

    beside(shout("x/view", 0), shout("y/hello", 1), shout("c0/view", 2), shout("c0/heartbeat", 3))
    assert inbox.unknown_senders == 2 * ROUNDS
    assert inbox.wrong + inbox.flooded == 2 * ROUNDS


def test_every_record_that_finds_no_room_is_counted(tmp_path: Path) -> None:
    run = Run("lab", "lab", 0, 0.05, "coco17", ("nose",), ("c0",), "test")
    writer = StoreWriter(tmp_path / "poses.db", run, WriterSettings(queue_slots=0))
    writer._shed = Slow(0)

    def give(i: int) -> None:
        assert not writer.event(Event(i, "test", "event"))

    beside(give, give, give)
    assert writer.status().shed == 3 * ROUNDS
    writer.close()


class _Closing:
    """An event loop that is closed right after somebody looked whether it is."""

    def is_closed(self) -> bool:
        return False

    def call_soon_threadsafe(self, *_: object) -> None:
        raise RuntimeError("Event loop is closed")


def test_feed_is_left_while_messages_arrive() -> None:
    feed = Feed("lab")

    def follow(_: int) -> None:
        feed.attach(_Closing())  # type: ignore[arg-type]
        feed.attach(None)

    beside(follow, lambda i: feed._hand_on(None))  # type: ignore[arg-type]
