"""The newest message for a topic and slot is sent, and only it."""

from __future__ import annotations

import threading

from e3pose.edge.send_queue import MAX_WAITING, SendQueue


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


def test_sender_waits_and_ends_when_closed() -> None:
    queue, sent = SendQueue(), threading.Event()
    thread = threading.Thread(target=queue.run, args=(lambda topic, payload, slot: sent.set(),))
    thread.start()
    queue.put("a", b"1")
    assert sent.wait(5)
    queue.close()
    thread.join(5)
    assert not thread.is_alive()
