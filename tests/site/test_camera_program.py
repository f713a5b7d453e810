"""A camera says that it waits for its edge, once, and when that comes and goes."""

from __future__ import annotations

from e3pose.site.camera_program import EdgeWatch


def test_edge_that_does_not_come_is_told_once() -> None:
    told: list[str] = []
    watch = EdgeWatch(told.append, "tcp/127.0.0.1:7447", alone_s=5.0)
    for now_s in (100.0, 102.0, 104.9):
        watch.look(False, now_s)
    assert not told
    for now_s in (105.0, 106.0, 300.0):
        watch.look(False, now_s)
    assert len(told) == 1 and "tcp/127.0.0.1:7447" in told[0]
    watch.look(True, 301.0)
    watch.look(True, 302.0)
    watch.look(False, 303.0)
    watch.look(False, 400.0)
    assert told[1:] == ["edge connected", "edge disconnected, reconnecting"]


def test_edge_that_is_there_at_once_is_told() -> None:
    told: list[str] = []
    watch = EdgeWatch(told.append, "tcp/127.0.0.1:7447")
    watch.look(True, 0.0)
    watch.look(True, 100.0)
    assert told == ["edge connected"]
