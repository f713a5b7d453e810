"""An edge that is too slow for its slots, and one whose status is made all the time."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, HERE, LiveSite
from tests.waiting import eventually

from e3pose.settings.site_file import load_site
from e3pose.site.follow import viewer_link
from e3pose.wire.codec import encode
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Control
from e3pose.wire.topics import of_control

pytestmark = pytest.mark.live

BLAMES = ("far longer", "too late", "no views arrive", "answers")  # of a camera
STATUSES = 1000


class OddSite(LiveSite):
    """A site whose edge has a habit."""

    habit = ""

    def start_edge(self) -> None:
        self.start("edge", sys.executable, str(HERE / "odd_edge.py"), self.habit, str(self.path))


def made(folder: Path, recording: Path, habit: str) -> OddSite:
    (folder / "recording").symlink_to(recording)
    site = OddSite(folder)
    site.habit = habit
    return site


@pytest.mark.timed
def test_slow_edge_is_told_and_no_camera_is_blamed(tmp_path: Path, recording: Path) -> None:
    with made(tmp_path, recording, "slow").at_work() as site:
        site.flows(40)
        since = len(site.statuses)
        site.send("edge", signal.SIGUSR1)
        assert eventually(lambda: site.status().overload), site.diagnostics()
        # Round robin helps no edge whose views cost most: every second slot does.
        assert eventually(lambda: "every second slot" in site.status().overload), site.diagnostics()
        site.flows(100)
        site.send("edge", signal.SIGUSR2)

        def told() -> list[str]:
            return [event["event"] for event in site.events("overload")]

        assert eventually(lambda: "edge load is back to normal" in told()[-1], 90.0), (
            site.diagnostics()
        )
        site.becomes(*CAMERAS)
        assert "edge overloaded, computing takes " in told()[0]
        blamed = {c.why for c in site.cameras_since(since) if any(b in c.why for b in BLAMES)}
        assert not blamed, site.diagnostics()
        assert not site.events("camera-useless"), site.diagnostics()


def test_status_is_made_all_the_time_while_messages_of_all_kinds_arrive(
    tmp_path: Path, recording: Path
) -> None:
    with made(tmp_path, recording, "eager").at_work() as site:
        site.without("cam2")
        site.start_odd_camera("cam2", "flood")
        desk = tmp_path / "keys" / "operators" / "desk"
        transport = open_network(viewer_link(load_site(site.path), desk))
        topic = of_control("lab", "desk")
        assert eventually(transport.connected)
        count = len(site.statuses)

        def told() -> bool:
            """Change what status and events tell; return whether there were many of both."""
            for budget in ("60%", "70%"):
                transport.ask(topic, encode(Control(camera_id="cam0", budget=budget)), 2.0)
            return len(site.statuses) > count + STATUSES and bool(site.events("control"))

        try:
            assert eventually(told, 120.0), (len(site.statuses) - count, site.diagnostics())
        finally:
            transport.close()
        site.flows(20)
        assert site.programs["edge"].poll() is None, site.diagnostics()
