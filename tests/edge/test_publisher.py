"""What leaves the edge: poses once they are stored, and the newest message of each topic."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.edge.one_process import scene
from tests.manual_clock import ManualClock
from tests.waiting import eventually

from e3pose.edge.publisher import MOST_WAITING, Publisher
from e3pose.edge.send_queue import MAX_WAITING, SendQueue
from e3pose.estimate.base import Estimate
from e3pose.evaluate.replay import replay
from e3pose.pipeline import SlotRecord
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.loop import ReplaySettings
from e3pose.store import Run, StoreWriter, WriterSettings
from e3pose.store.writer import WriterStatus

Computed = list[tuple[SlotRecord, Estimate]]
FINE = WriterStatus(-1, 0, 0, 0, None)


@pytest.fixture(scope="module")
def computed() -> Computed:
    estimates: list[Estimate] = []
    settings = ReplaySettings(policy="round-robin", num_selected=2)
    records = list(replay(scene(), settings, publish=estimates.append))
    return list(zip(records, estimates, strict=True))


class Edge:
    """What an edge does with computed slots, and what it sent."""

    def __init__(self, delay_s: float = 0.0) -> None:
        settings = EdgeSettings(
            "lab", scene().skeleton, 0.1, (), publish_stored=True, smooth_delay_s=delay_s
        )
        self.queue, rig = SendQueue(), scene().rig
        self._publisher = Publisher(settings, rig, scene().interval_s, self.queue, ManualClock())
        self._nobody = np.zeros(len(rig), dtype=bool)

    def slot(self, record: SlotRecord, estimate: Estimate, stored: WriterStatus) -> None:
        self._publisher.publish(record.slot, 0, estimate, {}, self._nobody, stored=stored)
        self._publisher.publish_delayed(record, 0, busy=False)

    def sent(self) -> Iterator[tuple[str, int]]:
        found = list[tuple[str, int]]()
        self.queue.send_waiting(lambda topic, _, slot: found.append((topic.split("/")[-1], slot)))
        yield from found


def test_every_slot_that_is_sent_is_in_the_database(tmp_path: Path, computed: Computed) -> None:
    path, edge, sent = tmp_path / "live.db", Edge(delay_s=0.2), list[tuple[str, int]]()
    recording = scene()
    run = Run("lab", "lab", 1, recording.interval_s, "coco17", recording.skeleton.joints,
              recording.rig.camera_ids)  # fmt: skip
    with StoreWriter(path, run, WriterSettings(commit_s=0.01)) as writer:
        for record, estimate in computed:
            edge.slot(record, estimate, writer.status())
            assert writer.append(record)
            for topic, slot in edge.sent():
                sent.append((topic, slot))
                with closing(sqlite3.connect(path)) as reader:
                    assert reader.execute(f"SELECT 1 FROM slots WHERE slot = {slot}").fetchone()
        last, estimate = computed[-1]
        assert eventually(lambda: writer.status().acknowledged_slot == last.slot)
        edge.slot(replace(last, slot=last.slot + 1), estimate, writer.status())
        sent += edge.sent()
    slots = [slot for topic, slot in sent if topic == "poses"]
    assert slots == [record.slot for record, _ in computed]  # each once, in order
    assert len(sent) - len(slots) > len(computed) // 2  # the smoothed ones, too


def test_slots_wait_for_a_store_in_trouble_and_the_oldest_are_given_up(computed: Computed) -> None:
    edge, (record, estimate) = Edge(), computed[0]
    for slot in range(MOST_WAITING + 50):
        edge.slot(replace(record, slot=slot), estimate, replace(FINE, problem="full"))
        assert not list(edge.sent())
    edge.slot(replace(record, slot=999), estimate, replace(FINE, acknowledged_slot=998))
    assert len(list(edge.sent())) == MOST_WAITING - 1


def test_nothing_is_sent_that_the_store_may_have_given_up(computed: Computed) -> None:
    edge, (record, estimate) = Edge(), computed[0]
    for slot in range(3):
        edge.slot(replace(record, slot=slot), estimate, FINE)
    edge.slot(replace(record, slot=3), estimate, replace(FINE, acknowledged_slot=2, shed=1))
    assert not list(edge.sent())
    edge.slot(replace(record, slot=4), estimate, replace(FINE, acknowledged_slot=3, shed=1))
    assert list(edge.sent()) == [("poses", 3)]


def drained(queue: SendQueue) -> list[tuple[str, bytes]]:
    sent: list[tuple[str, bytes]] = []
    queue.close()
    queue.run(lambda topic, payload, slot: sent.append((topic, payload)))
    return sent


def test_newer_message_replaces_the_older() -> None:
    queue = SendQueue()
    queue.put("a", b"1")
    queue.put("b", b"2", slot=7)
    queue.put("b", b"3", slot=8)
    queue.put("a", b"4")
    assert drained(queue) == [("b", b"2"), ("b", b"3"), ("a", b"4")]


def test_what_nobody_takes_does_not_grow() -> None:
    queue = SendQueue()
    for slot in range(3 * MAX_WAITING):
        queue.put("a", b"x", slot)
    assert len(drained(queue)) == MAX_WAITING


def test_later_sender_takes_over_from_one_that_hangs() -> None:
    queue, sent, hanging, go_on = SendQueue(), list[str](), threading.Event(), threading.Event()

    def hang(topic: str, payload: bytes, slot: int) -> None:
        hanging.set()
        go_on.wait(5)

    first = threading.Thread(target=queue.run, args=(hang,))
    first.start()
    queue.put_all({"a": b"1", "b": b"2"})
    assert hanging.wait(5)
    queue.put("old", b"3")
    arrived = threading.Event()

    def send(topic: str, payload: bytes, slot: int) -> None:
        sent.append(topic)
        arrived.set()

    second = threading.Thread(target=queue.run, args=(send,))
    second.start()
    while queue._runs < 2:
        pass
    queue.put("new", b"4")
    assert arrived.wait(5)
    go_on.set()
    first.join(5)
    assert not first.is_alive() and sent == ["new"]
    queue.close()
    second.join(5)
    assert not second.is_alive()
