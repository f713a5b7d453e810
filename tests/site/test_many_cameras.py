"""Turns of cameras that share a program: how many at a time, and what each is charged."""

from __future__ import annotations

import threading
import time

import pytest

from e3pose.detectors import looks_at_a_time
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.settings.camera_file import NodeTable, load_node
from e3pose.site import many_cameras
from e3pose.site.many_cameras import Turns, TurnTime


def burn(seconds: float) -> None:
    """Use a core of this thread for a while."""
    end_ns = time.thread_time_ns() + round(seconds * 1e9)
    while time.thread_time_ns() < end_ns:
        pass


def test_no_more_than_so_many_look_at_a_time() -> None:
    turns, most, now, lock = Turns(2, 6), [0], [0], threading.Lock()

    def look() -> None:
        with TurnTime(turns).looking():
            with lock:
                now[0] += 1
                most[0] = max(most[0], now[0])
            time.sleep(0.02)
            with lock:
                now[0] -= 1

    threads = [threading.Thread(target=look) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most[0] == 2


def test_turn_is_given_back_by_a_look_that_fails() -> None:
    time_ = TurnTime(Turns(1, 2))
    for _ in range(3):
        with pytest.raises(ValueError, match="broken"), time_.looking():
            raise ValueError("broken")


def test_cameras_are_charged_their_looks_and_a_share_of_the_rest() -> None:
    turns = Turns(2, 2)
    one, other = TurnTime(turns), TurnTime(turns)
    begun_ns = time.process_time_ns()

    def look() -> None:
        with one.looking():
            burn(0.2)

    thread = threading.Thread(target=look)
    thread.start()
    burn(0.1)  # of the program, beside the look
    thread.join()
    passed_s = (time.process_time_ns() - begun_ns) / 1e9
    assert one.look_s == pytest.approx(0.2, abs=0.02) and other.look_s == 0.0
    assert one.total_s + other.total_s == pytest.approx(passed_s, abs=0.02)
    assert one.total_s - one.look_s == pytest.approx(other.total_s, abs=0.01)


def test_look_takes_one_thread_where_the_network_allows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A network says by itself whether looks go on beside each other; no name is asked."""
    monkeypatch.setattr("e3pose.detectors.num_cores", lambda: 8)
    said = {"site": "lab", "camera": "cam1", "source": "usb:0", "endpoint": "tcp/127.0.0.1:7001"}
    for beside, asked, cameras, loads, at_a_time in (
        (True, None, 4, [1], 8),
        (True, None, 1, [None], 1),
        (True, 3, 4, [3], 2),
        (False, None, 4, [1, None], 1),  # OpenCV has one pool for all, a device one queue
        (False, 2, 4, [2], 1),
    ):
        loaded = list[int | None]()

        class Made:
            skeleton = COCO17

            def __init__(self, threads: int | None, beside: bool) -> None:
                self.threads = (threads or 8) if beside else None

            def detect(self, image: object) -> Poses2D:
                return Poses2D.empty(17)

        def load(
            node: NodeTable, name: str, beside: bool = beside, loaded: list[int | None] = loaded
        ) -> Made:
            loaded.append(node.threads)
            return Made(node.threads, beside)

        monkeypatch.setattr(many_cameras, "load_detector", load)
        node = load_node(None, {**said, **({} if asked is None else {"threads": asked})})
        made = many_cameras.load_for(node, cameras)
        assert loaded == loads, (beside, asked, cameras)
        assert looks_at_a_time([made]) == at_a_time
