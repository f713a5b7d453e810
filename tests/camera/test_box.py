"""Room for one: the newest wins."""

from __future__ import annotations

import threading

from e3pose.camera.live import Box


def test_newest_wins_and_the_rest_is_counted() -> None:
    box: Box[int] = Box()
    for thing in (1, 2, 3):
        box.put(thing)
    assert box.take() == 3 and box.dropped == 2


def test_taker_waits_and_is_let_go() -> None:
    box: Box[int] = Box()
    found: list[int | None] = []
    thread = threading.Thread(target=lambda: found.append(box.take()))
    thread.start()
    box.close()
    thread.join(5)
    assert found == [None] and box.take() is None
