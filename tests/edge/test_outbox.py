"""The newest message for a topic and slot is sent, and only it."""

from __future__ import annotations

import threading

from e3pose.edge.outbox import MAX_WAITING, Outbox


def drained(outbox: Outbox) -> list[tuple[str, bytes]]:
    sent: list[tuple[str, bytes]] = []
    outbox.close()
    outbox.run(lambda topic, payload, slot: sent.append((topic, payload)))
    return sent


def test_newer_message_replaces_the_older() -> None:
    outbox = Outbox()
    outbox.put("a", b"1")
    outbox.put("b", b"2", slot=7)
    outbox.put("b", b"3", slot=8)
    outbox.put("a", b"4")
    assert drained(outbox) == [("b", b"2"), ("b", b"3"), ("a", b"4")]


def test_what_nobody_takes_does_not_grow() -> None:
    outbox = Outbox()
    for slot in range(3 * MAX_WAITING):
        outbox.put("a", b"x", slot)
    assert len(drained(outbox)) == MAX_WAITING


def test_later_sender_takes_over_from_one_that_hangs() -> None:
    outbox, sent, hanging, go_on = Outbox(), list[str](), threading.Event(), threading.Event()

    def hang(topic: str, payload: bytes, slot: int) -> None:
        hanging.set()
        go_on.wait(5)

    first = threading.Thread(target=outbox.run, args=(hang,))
    first.start()
    outbox.put_all({"a": b"1", "b": b"2"})
    assert hanging.wait(5)
    outbox.put("old", b"3")
    arrived = threading.Event()

    def send(topic: str, payload: bytes, slot: int) -> None:
        sent.append(topic)
        arrived.set()

    second = threading.Thread(target=outbox.run, args=(send,))
    second.start()
    while outbox._runs < 2:
        pass
    outbox.put("new", b"4")
    assert arrived.wait(5)
    go_on.set()
    first.join(5)
    assert not first.is_alive() and sent == ["new"]
    outbox.close()
    second.join(5)


def test_sender_waits_and_ends_when_closed() -> None:
    outbox, sent = Outbox(), threading.Event()
    thread = threading.Thread(target=outbox.run, args=(lambda topic, payload, slot: sent.set(),))
    thread.start()
    outbox.put("a", b"1")
    assert sent.wait(5)
    outbox.close()
    thread.join(5)
    assert not thread.is_alive()
