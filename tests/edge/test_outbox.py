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


def test_sender_waits_and_ends_when_closed() -> None:
    outbox, sent = Outbox(), threading.Event()
    thread = threading.Thread(target=outbox.run, args=(lambda topic, payload, slot: sent.set(),))
    thread.start()
    outbox.put("a", b"1")
    assert sent.wait(5)
    outbox.close()
    thread.join(5)
    assert not thread.is_alive()
