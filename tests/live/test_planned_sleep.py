"""A site whose edge plans who sleeps: cameras come and go by themselves, and none is lost."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from tests.live.processes import LiveSite
from tests.waiting import eventually

pytestmark = [pytest.mark.timed, pytest.mark.nightly]

CALM = 60  # statuses, one a second, without an overload: meanwhile nobody is sent to rest


class PlannedSite(LiveSite):
    """A site that may let cameras sleep, and has the watts for no more than one awake."""

    def write(self) -> None:
        super().write()
        text = self.path.read_text()
        text = text.replace('policy = "round-robin"\ncameras = 2\n', 'policy = "information"\n')
        self.path.write_text(text.replace("[loop]\n", '[loop]\nrest = "asleep"\nwatts = "17.2W"\n'))

    def falls_asleep(self, since: int) -> str:
        """Wait until a camera sleeps; return which."""

        def asleep() -> set[str]:
            return {c.camera_id for c in self.cameras_since(since) if c.mode == "asleep"}

        def calm() -> bool:
            said = [status.overload for _, status in self.statuses[since:]]
            return said.count("") > CALM

        assert eventually(lambda: asleep() or calm(), 4 * CALM), self.diagnostics()
        assert asleep(), self.diagnostics()
        return min(asleep())

    def comes_back(self, camera_id: str, since: int) -> None:
        def there() -> bool:
            back = (c for c in self.cameras_since(since) if c.camera_id == camera_id)
            return any(c.online for c in back)

        assert eventually(there, 90.0), self.diagnostics()
        self.flows(20)


def test_cameras_sleep_by_a_plan_that_goes_on_when_the_edge_is_killed(
    tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "recording").symlink_to(recording)
    site = PlannedSite(tmp_path, more=('state = "state.npz"',))
    with site.at_work():
        site.comes_back(site.falls_asleep(0), len(site.statuses))
        assert not site.events("camera-lost"), site.diagnostics()
        one = site.falls_asleep(len(site.statuses))
        site.send("edge", signal.SIGKILL)
        site.wait("edge")
        since = len(site.statuses)
        site.start_edge()
        site.comes_back(one, since)
        said = [e["event"] for e in site.events("camera-lost")]
        assert not said, said
        assert not site.events("camera-moved"), site.diagnostics()
