"""Cameras behind a router that sleep by order, through kills of whoever expects them.

`tests/edge/test_sleep.py` looks at sleep in one process, and where clocks are set.
"""

from __future__ import annotations

import datetime
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, HERE, LiveSite, e3pose
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.wire.keys.folder import add_keys

pytestmark = [pytest.mark.timed, pytest.mark.nightly]


@dataclass(eq=False)
class SleepySite(LiveSite):
    """A site whose cameras sleep by turns, behind a router."""

    def start_edge(self) -> None:
        self.start("edge", sys.executable, str(HERE / "sleepy_edge.py"), str(self.path))
        if "hall" not in self.programs:
            self.start_router()

    def start_router(self) -> None:
        keys, edge = self.folder / "keys", f"tls/localhost:{self.port}"
        if not (keys / "routers" / "hall").exists():
            add_keys(keys, "hall", datetime.datetime.now(datetime.timezone.utc), kind="router")
        listen = f"tls/127.0.0.1:{self.camera_port}"
        command = ("router", str(keys / "routers" / "hall"), "--endpoint", listen, "--edge", edge)
        self.start("hall", *e3pose(*command))

    def kill(self, *names: str) -> None:
        for name in names:
            self.send(name, signal.SIGKILL)
            self.wait(name)

    def asleep(self, camera_id: str) -> bool:
        camera = self.camera(camera_id)
        return not camera.online and camera.why.startswith("asleep for")

    def falls_asleep(self, camera_id: str) -> None:
        assert eventually(lambda: self.camera(camera_id).online), self.diagnostics()
        assert eventually(lambda: self.asleep(camera_id)), self.diagnostics()

    def comes_back(self, camera_id: str) -> None:
        """Wait until a camera is online, and until views of it are in the poses."""
        assert eventually(lambda: self.camera(camera_id).online), self.diagnostics()
        count = len(self.poses)
        assert eventually(lambda: any(camera_id in p.arrived for p in self.poses[count:]))

    def said_lost(self, camera_id: str) -> list[str]:
        return [e["event"] for e in self.events("camera-lost") if e.get("camera") == camera_id]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[SleepySite]:
    folder = tmp_path_factory.mktemp("sleepy")
    (folder / "recording").symlink_to(recording)
    made = SleepySite(folder, more=('state = "state.npz"',), camera_port=free_port())
    with made.at_work():
        yield made


def test_killed_edge_still_expects_the_cameras_that_sleep(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    lost = len(site.said_lost("cam2"))
    site.kill("edge")
    statuses = len(site.statuses)
    site.start_edge()
    assert eventually(lambda: len(site.statuses) > statuses + 1), site.diagnostics()
    site.comes_back("cam2")
    said = {c.why for c in site.cameras_since(statuses) if c.camera_id == "cam2" and c.why}
    assert len(site.said_lost("cam2")) == lost, said
    site.falls_asleep("cam2")  # and is sent to sleep by the next edge as well
    site.comes_back("cam2")


def test_camera_that_slept_through_a_restart_of_its_router_is_heard_again(
    site: SleepySite,
) -> None:
    site.falls_asleep("cam2")
    site.kill("hall")
    site.start_router()
    site.comes_back("cam2")
    site.flows(20)


def test_all_are_killed_while_a_camera_sleeps(site: SleepySite) -> None:
    site.falls_asleep("cam2")
    site.kill("edge", "hall", *CAMERAS)
    site.start_edge()
    for camera_id in CAMERAS:
        site.start_camera(camera_id)
    count, lost = len(site.poses), len(site.said_lost("cam2"))
    assert eventually(lambda: len(site.poses) > count + 20, 60.0), site.diagnostics()
    site.comes_back("cam2")
    site.falls_asleep("cam2")
    site.comes_back("cam2")
    assert len(site.said_lost("cam2")) == lost, site.diagnostics()
