"""Clocks that jump while cameras sleep: the camera's, the edge's, forward and back."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS
from tests.live.sleepy_site import SleepySite, sleepy_site
from tests.waiting import eventually

pytestmark = [pytest.mark.live, pytest.mark.timed]

HOUR_S = 3600.0


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[SleepySite]:
    with sleepy_site(tmp_path_factory.mktemp("jumpy"), recording, movable=True) as made:
        yield made


def goes_on(site: SleepySite, lost: int) -> None:
    """Assert that a camera that slept through a jump comes back, sleeps again and is not lost."""
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")
    assert len(site.said_lost("cam2")) == lost, site.diagnostics()
    site.flows(20)


@pytest.mark.parametrize("seconds", [HOUR_S, -HOUR_S])
def test_time_of_day_of_a_camera_is_set_while_it_sleeps(site: SleepySite, seconds: float) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.move("cam2", system_s=seconds)
    goes_on(site, lost)


@pytest.mark.parametrize("seconds", [HOUR_S, -HOUR_S])
def test_clock_of_a_camera_jumps_while_it_sleeps(site: SleepySite, seconds: float) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.move("cam2", steady_s=seconds)
    goes_on(site, lost)


@pytest.mark.parametrize("seconds", [HOUR_S, -HOUR_S])
def test_time_of_day_of_the_edge_is_set_while_a_camera_sleeps(
    site: SleepySite, seconds: float
) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.move("edge", system_s=seconds)
    goes_on(site, lost)


@pytest.mark.parametrize("seconds", [30.0, HOUR_S])
def test_edge_that_was_suspended_while_a_camera_slept_learns_nothing_of_its_wake(
    site: SleepySite, seconds: float
) -> None:
    """Its clock jumps; the camera is not late, and needs no earlier alarm from then on."""
    site.falls_asleep("cam2")
    before_s = site.camera("cam2").wake_s or 0.0
    site.move("edge", steady_s=seconds)
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")
    assert (site.camera("cam2").wake_s or 0.0) < before_s + 1.0, site.diagnostics()
    site.flows(20)


@pytest.mark.parametrize("seconds", [HOUR_S, -HOUR_S])
def test_edge_is_killed_and_its_clock_set_while_a_camera_sleeps(
    site: SleepySite, seconds: float
) -> None:
    site.falls_asleep("cam2")
    site.send("cam2", signal.SIGSTOP)  # as a machine that is suspended: it sees nothing of it
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    site.move("edge", system_s=seconds)
    statuses = len(site.statuses)
    site.start_edge()
    assert eventually(lambda: len(site.statuses) > statuses + 1), site.diagnostics()
    site.send("cam2", signal.SIGCONT)
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")


def test_all_are_killed_while_a_camera_sleeps(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    for name in ("edge", "hall", *CAMERAS):
        site.send(name, signal.SIGKILL)
        site.wait(name)
    site.start_edge()
    for camera_id in CAMERAS:
        site.start_camera(camera_id)
    count = len(site.poses)
    assert eventually(lambda: len(site.poses) > count + 20, 60.0), site.diagnostics()
    goes_on(site, len(site.said_lost("cam2")))
