"""An edge whose network is stuck joins it again, one that is slow says so; none blames a camera."""

from __future__ import annotations

import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, HERE, LiveSite
from tests.waiting import eventually

from e3pose.edge.housekeeping import STALL_S

pytestmark = pytest.mark.timed

REJOINED_S = 5.0
BLAMES = ("far longer", "too late", "no views arrive", "answers")  # of a camera


class OddSite(LiveSite):
    """A site whose edge takes a habit on order."""

    def start_edge(self) -> None:
        self.start("edge", sys.executable, str(HERE / "odd_edge.py"), str(self.path))

    def takes(self, habit: str) -> float:
        """Let the edge take a habit; return the time."""
        (self.folder / "habit").write_text(habit)
        return self.send("edge", signal.SIGUSR1)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[OddSite]:
    folder = tmp_path_factory.mktemp("odd")
    (folder / "recording").symlink_to(recording)
    made = OddSite(folder)
    with made.at_work():
        yield made


def joins_again(site: OddSite, habit: str, why: str) -> None:
    """Assert that the edge finds out, says why, and has the views of its cameras again."""
    site.whole()
    site.flows(20)
    before = len(site.events("stalled"))
    stuck_s = site.takes(habit)
    assert eventually(lambda: len(site.events("rejoined")) > before), site.diagnostics()
    assert time.monotonic() - stuck_s < REJOINED_S + 2.0  # how long one looks after a busy test
    site.becomes(*CAMERAS)
    site.flows(30)

    def views_flow() -> bool:
        return sum(len(poses.arrived) for poses in site.poses[-30:]) >= 45

    assert eventually(views_flow), site.diagnostics()
    [event] = site.events("stalled")[before:]
    assert why in event["event"]
    place = re.search(r"stacks of all threads are in (\S+)", event["event"])
    assert place is not None and Path(place[1]).parent == site.folder / "logs"
    assert "_run_slots" in Path(place[1]).read_text()


def test_edge_whose_cameras_are_gone_or_frozen_stays(site: OddSite) -> None:
    site.whole()
    before = len(site.events("stalled"))
    for camera_id in CAMERAS:
        site.send(camera_id, signal.SIGSTOP)
    site.becomes()
    site.flows(round(20 * 1.5 * STALL_S))
    for camera_id in CAMERAS:
        site.send(camera_id, signal.SIGCONT)
    site.becomes(*CAMERAS)
    for camera_id in CAMERAS:
        site.send(camera_id, signal.SIGKILL)
        site.wait(camera_id)
    site.becomes()
    site.flows(round(20 * 1.5 * STALL_S))
    site.whole()
    site.flows(20)
    assert len(site.events("stalled")) == before, site.diagnostics()


def test_edge_that_cannot_send_joins_again(site: OddSite) -> None:
    joins_again(site, "blocked", "a message could not be sent")


@pytest.mark.nightly  # half a minute; tests/edge/test_overload.py has its parts
def test_slow_edge_is_told_and_no_camera_is_blamed(site: OddSite) -> None:
    site.whole()
    site.flows(40)
    since, before = len(site.statuses), len(site.events("overload"))
    useless = len(site.events("camera-useless"))
    site.takes("slow")
    assert eventually(lambda: site.status().overload), site.diagnostics()
    # Round robin helps no edge whose views cost most: every second slot does.
    assert eventually(lambda: "every second slot" in site.status().overload), site.diagnostics()
    site.flows(100)
    site.takes("well")

    def told() -> list[str]:
        return [event["event"] for event in site.events("overload")[before:]]

    assert eventually(lambda: "edge load is back to normal" in told()[-1], 90.0), site.diagnostics()
    site.becomes(*CAMERAS)
    assert "edge overloaded, computing takes " in told()[0]
    blamed = {c.why for c in site.cameras_since(since) if any(b in c.why for b in BLAMES)}
    assert not blamed, site.diagnostics()
    assert len(site.events("camera-useless")) == useless, site.diagnostics()


@pytest.mark.nightly
def test_edge_that_receives_nothing_joins_again(site: OddSite) -> None:
    """After the test before: an edge that joined again in vain waits with the next try."""
    joins_again(site, "lost", "nothing arrives from cameras that are connected")
