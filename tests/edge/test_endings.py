"""A camera that is stopped says so, and is not reported as lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.edge.one_process import site_at_work
from tests.waiting import eventually

from e3pose.edge.roster import CameraLife, come_or_go, greet, take_beat, trouble
from e3pose.wire.messages import Heartbeat, Hello


def test_camera_that_ends_is_said_to_have_ended_and_comes_back(tmp_path: Path) -> None:
    with site_at_work(tmp_path) as site:
        site.nodes["cam1"].stop()
        assert eventually(lambda: site.camera("cam1").why == "stopped")
        assert not site.camera("cam1").online
        assert eventually(lambda: site.reported("camera-lost", "cam1"))
        words = [event.message for event in site.events if event.camera_id == "cam1"]
        assert words[-1] == "cam1: stopped"
        site.start_camera("cam1")
        assert eventually(lambda: site.camera("cam1").online)


@pytest.mark.parametrize("first", ["word", "connection"])
def test_order_of_the_last_word_and_the_lost_connection_is_no_matter(first: str) -> None:
    life = greet(CameraLife("cam0"), Hello("cam0", 7, ("nose",), (640, 480), 20.0), 1)
    last = Heartbeat("cam0", 7, 2, "power-saving", captured=1, ends=True)
    life = take_beat(life, last, 2) if first == "word" else come_or_go(life, False, 2)
    life = come_or_go(life, False, 3) if first == "word" else take_beat(life, last, 3)
    assert trouble(life, ("nose",), (640, 480), 4) == "stopped"
    life = come_or_go(life, True, 5)
    life = greet(life, Hello("cam0", 8, ("nose",), (640, 480), 20.0), 6)
    life = take_beat(life, Heartbeat("cam0", 8, 7, "power-saving", captured=1), 7)
    assert trouble(life, ("nose",), (640, 480), 8) == ""


def test_empty_battery_says_whose_word_that_is() -> None:
    life = greet(CameraLife("cam0"), Hello("cam0", 7, ("nose",), (640, 480), 20.0), 1)
    for gauge, reported in ((True, "battery empty"), (False, "battery empty (modelled)")):
        beat = Heartbeat("cam0", 7, 2, "active", captured=1, battery_j=0.0, gauge=gauge)
        assert trouble(take_beat(life, beat, 2), ("nose",), (640, 480), 3) == reported
