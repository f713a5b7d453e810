"""An edge that is connected and yet useless joins its network again; one that is not does not."""

from __future__ import annotations

import re
import signal
import sys
import time
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, HERE, LiveSite
from tests.waiting import eventually

from e3pose.edge.watchdog import STALL_S

pytestmark = [pytest.mark.live, pytest.mark.timed]

REJOINED_S = 5.0


class StuckSite(LiveSite):
    """A site whose edge gets stuck on SIGUSR1."""

    fault = ""

    def start_edge(self) -> None:
        self.start("edge", sys.executable, str(HERE / "stuck_edge.py"), self.fault, str(self.path))


def made(folder: Path, recording: Path, fault: str = "blocked") -> StuckSite:
    (folder / "recording").symlink_to(recording)
    site = StuckSite(folder)
    site.fault = fault
    return site


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("blocked", "a message could not be sent"),
        ("all-lost", "nothing arrives from cameras that are connected"),
    ],
)
def test_edge_that_is_stuck_joins_again(
    tmp_path: Path, recording: Path, fault: str, why: str
) -> None:
    with made(tmp_path, recording, fault).at_work() as site:
        site.flows(20)
        stuck_s = site.send("edge", signal.SIGUSR1)
        assert eventually(lambda: site.events("rejoined")), site.diagnostics()
        assert time.monotonic() - stuck_s < REJOINED_S + 2.0  # how long one looks after a busy test
        site.becomes(*CAMERAS)
        site.flows(30)

        def views_flow() -> bool:
            return sum(len(poses.arrived) for poses in site.poses[-30:]) >= 45

        assert eventually(views_flow), site.diagnostics()
        [event] = site.events("stalled")
        assert why in event["event"]
        place = re.search(r"stacks of all threads are in (\S+)", event["event"])
        assert place is not None and Path(place[1]).parent == tmp_path / "logs"
        assert "_run_slots" in Path(place[1]).read_text()


def test_edge_whose_cameras_are_gone_or_frozen_stays(tmp_path: Path, recording: Path) -> None:
    with made(tmp_path, recording).at_work() as site:
        for camera_id in CAMERAS:
            site.send(camera_id, signal.SIGSTOP)
        site.becomes()
        site.flows(round(20 * 2 * STALL_S))
        for camera_id in CAMERAS:
            site.send(camera_id, signal.SIGCONT)
        site.becomes(*CAMERAS)
        site.flows(20)
        for camera_id in CAMERAS:
            site.send(camera_id, signal.SIGKILL)
            site.wait(camera_id)
        site.becomes()
        site.flows(round(20 * 2 * STALL_S))
        site.whole()
        site.flows(20)
        assert not site.events("stalled"), site.diagnostics()
