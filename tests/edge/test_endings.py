"""A camera that is stopped says so, and is not reported as lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.edge.one_process import site_at_work
from tests.waiting import eventually

from e3pose.edge.roster import CameraState, problem, with_heartbeat, with_hello, with_presence
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
    camera = with_hello(CameraState("cam0"), Hello("cam0", 7, ("nose",), (640, 480), 20.0), 1)
    last = Heartbeat("cam0", 7, 2, "power-saving", captured=1, ends=True)
    camera = with_heartbeat(camera, last, 2) if first == "word" else with_presence(camera, False, 2)
    camera = with_presence(camera, False, 3) if first == "word" else with_heartbeat(camera, last, 3)
    assert problem(camera, ("nose",), (640, 480), 4) == "stopped"
    camera = with_presence(camera, True, 5)
    camera = with_hello(camera, Hello("cam0", 8, ("nose",), (640, 480), 20.0), 6)
    camera = with_heartbeat(camera, Heartbeat("cam0", 8, 7, "power-saving", captured=1), 7)
    assert problem(camera, ("nose",), (640, 480), 8) == ""


def test_empty_battery_says_whose_word_that_is() -> None:
    camera = with_hello(CameraState("cam0"), Hello("cam0", 7, ("nose",), (640, 480), 20.0), 1)
    for gauge, reported in ((True, "battery empty"), (False, "battery empty (modelled)")):
        beat = Heartbeat("cam0", 7, 2, "active", captured=1, battery_j=0.0, gauge=gauge)
        assert problem(with_heartbeat(camera, beat, 2), ("nose",), (640, 480), 3) == reported
