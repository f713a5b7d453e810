"""Cameras that sleep by order, also through kills of either side and jumps of clocks.

`tests/edge/test_sleep.py` looks at it in one process, and where the time of day is set.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS
from tests.live.sleepy_site import SleepySite, sleepy_site
from tests.waiting import eventually

from e3pose.wire.site_messages import CameraStatus

pytestmark = [pytest.mark.timed, pytest.mark.nightly]

HOUR_S = 3600.0


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[SleepySite]:
    with sleepy_site(tmp_path_factory.mktemp("sleepy"), recording, movable=True) as made:
        yield made


def test_camera_asleep_is_not_lost_and_comes_back_by_itself(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    camera = site.camera("cam2")
    assert camera.asleep_s is not None and camera.asleep_s > 0 and camera.mode == "asleep"
    site.flows(20)  # the others go on
    site.comes_back("cam2")
    woken: list[CameraStatus] = []

    def learned() -> bool:
        woken[:] = [c for c in site.cameras_since(0) if c.camera_id == "cam2" and c.wake_s]
        return bool(woken)

    assert eventually(learned), site.diagnostics()
    assert not site.said_lost("cam2") and not site.status().overload


def test_machine_is_suspended_with_its_own_alarm_and_a_late_one_is_told_and_learned(
    site: SleepySite,
) -> None:
    asked = site.folder / "rtcwake.txt"
    assert eventually(lambda: asked.exists() and asked.read_text().strip()), site.diagnostics()
    site.falls_asleep("cam1")
    assert eventually(lambda: site.camera("cam1").mode == "suspended")
    assert eventually(lambda: site.overslept("cam1")), site.diagnostics()
    assert eventually(lambda: (site.camera("cam1").wake_s or 0.0) > 1.0, 60.0), site.diagnostics()
    # Woken earlier, it is asked to suspend for less than before.
    first = int(asked.read_text().split()[0])
    assert eventually(lambda: int(asked.read_text().split()[-1]) < first, 60.0), asked.read_text()
    site.comes_back("cam1")


def test_killed_edge_still_expects_the_cameras_that_sleep(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    statuses = len(site.statuses)
    site.start_edge()
    assert eventually(lambda: len(site.statuses) > statuses + 1), site.diagnostics()
    site.comes_back("cam2")
    said = {c.why for c in site.cameras_since(statuses) if c.camera_id == "cam2" and c.why}
    assert len(site.said_lost("cam2")) == lost, said
    site.falls_asleep("cam2")  # and is sent to sleep by the next edge as well
    site.comes_back("cam2")


def test_camera_that_is_killed_in_its_sleep_goes_on_sleeping(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    site.send("cam2", signal.SIGKILL)
    site.wait("cam2")
    since = len(site.statuses)
    site.start_camera("cam2")
    assert eventually(
        lambda: any(c.camera_id == "cam2" and c.mode == "asleep" for c in site.cameras_since(since))
    ), site.diagnostics()
    site.comes_back("cam2")


def test_camera_that_slept_through_a_restart_of_its_router_is_heard_again(
    site: SleepySite,
) -> None:
    site.falls_asleep("cam2")
    site.send("hall", signal.SIGKILL)
    site.wait("hall")
    site.start_router()
    site.comes_back("cam2")
    site.flows(20)


def goes_on(site: SleepySite, lost: int) -> None:
    """Assert that a camera that slept through a jump comes back, sleeps again and is not lost."""
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")
    assert len(site.said_lost("cam2")) == lost, site.diagnostics()
    site.flows(20)


@pytest.mark.parametrize("seconds", [HOUR_S, -HOUR_S])
def test_clock_of_a_camera_jumps_while_it_sleeps(site: SleepySite, seconds: float) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.move("cam2", steady_s=seconds)
    goes_on(site, lost)


def test_edge_that_was_suspended_while_a_camera_slept_learns_nothing_of_its_wake(
    site: SleepySite,
) -> None:
    """Its clock jumps; the camera is not late, and needs no earlier alarm from then on."""
    site.falls_asleep("cam2")
    before_s = site.camera("cam2").wake_s or 0.0
    site.move("edge", steady_s=HOUR_S)
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")
    assert (site.camera("cam2").wake_s or 0.0) < before_s + 1.0, site.diagnostics()
    site.flows(20)


def test_edge_is_killed_and_its_clock_set_while_a_camera_sleeps(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    site.send("cam2", signal.SIGSTOP)  # as a machine that is suspended: it sees nothing of it
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    site.move("edge", system_s=-HOUR_S)
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


def test_camera_whose_clock_stood_still_in_its_sleep_comes_back(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    site.send("cam2", signal.SIGSTOP)  # as a machine that somebody else suspends
    # Late, and then also without a connection, which its program was to keep.
    late = ("overslept", "not connected")
    assert eventually(lambda: site.camera("cam2").why.startswith(late)), site.diagnostics()
    site.send("cam2", signal.SIGCONT)
    site.comes_back("cam2")
    site.send("edge", signal.SIGUSR1)
    site.becomes(*CAMERAS)
