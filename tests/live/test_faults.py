"""One site and its faults, one after the other.

Cameras die, freeze, come back, or shout. The network of the edge is stuck, and it joins again. It
is killed and restarted, its list of certificates changes, and in the end everybody is interrupted.
"""

from __future__ import annotations

import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from tests.cli import commands
from tests.live.processes import CAMERAS, HERE, LiveSite
from tests.waiting import eventually

from e3pose.edge.checkpoint import read_arrays
from e3pose.edge.housekeeping import STALL_S
from e3pose.edge.server import IDS_LEFT_OUT
from e3pose.store import Store
from e3pose.wire.access import VIEW_BYTES
from e3pose.wire.arrays import unpack

pytestmark = pytest.mark.timed

NOTICED_S = 2.0
BACK_S = 3.0
ENDED_S = 6.0  # a second on a machine that does nothing else
AWAY_SLOTS = 600  # half a minute: a slot that was numbered anew would be far from that
QUEUE_BYTES = 256 * VIEW_BYTES  # what the network keeps at most until it is read
REJOINED_S = 5.0


class OddSite(LiveSite):
    """A site whose edge sends nothing any more on SIGUSR1."""

    def start_edge(self) -> None:
        self.start("edge", sys.executable, str(HERE / "odd_edge.py"), str(self.path))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[OddSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    made = OddSite(folder, more=('state = "state.npz"',), tables=("[store]", 'path = "poses.db"'))
    with made.at_work():
        yield made


def looked(site: OddSite, since: int) -> list[float]:
    """Return how large a share of the slots since one each camera was selected in."""
    rows = [row for row in Store(site.folder / "poses.db").rows("slots") if row["slot"] >= since]
    assert len(rows) > 10
    return [
        sum(list(row["selected"])[index] in (1, "1") for row in rows) / len(rows)
        for index in range(len(CAMERAS))
    ]


def test_top_and_check_look_at_it(
    site: OddSite, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    site.whole()
    code, said = commands.run("top", site.path, "--once"), capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert "3/3 cameras" in said.out and all(camera_id in said.out for camera_id in CAMERAS)
    code, said = commands.run("check", site.path), capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert "running, slot" in said.out and said.out.count("connected, clock") == 3


def test_killed_camera_is_noticed_and_replaced_by_others(site: OddSite) -> None:
    site.whole()
    since = len(site.statuses)
    site.send("cam1", signal.SIGKILL)
    site.becomes("cam0", "cam2")
    assert site.longest_silence_s("cam1", since) < NOTICED_S
    site.flows(5)
    here = site.status().slot + 10
    site.stores(here + 20)
    first, killed, last = looked(site, here)
    assert killed == 0.0 and min(first, last) > 0.7  # but for slots whose orders were late
    site.wait("cam1")
    site.start_camera("cam1")  # as a supervisor would; it has another session now
    site.becomes(*CAMERAS)
    assert eventually(lambda: site.camera("cam1").duty > 0)


def test_frozen_camera_is_noticed_and_comes_back(site: OddSite) -> None:
    site.whole()
    since = len(site.statuses)
    site.send("cam2", signal.SIGSTOP)
    site.becomes("cam0", "cam1")
    assert 0 < site.longest_silence_s("cam2", since) < NOTICED_S
    here = site.status().slot
    site.flows(10)
    assert site.poses[-1].slot > here
    site.send("cam2", signal.SIGCONT)
    site.becomes(*CAMERAS)


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


def test_edge_that_cannot_send_says_why_joins_again_and_has_views(site: OddSite) -> None:
    site.whole()
    site.flows(20)
    before = len(site.events("stalled"))
    stuck_s = site.send("edge", signal.SIGUSR1)
    assert eventually(lambda: len(site.events("rejoined")) > before), site.diagnostics()
    assert time.monotonic() - stuck_s < REJOINED_S + 2.0  # how long one looks after a busy test
    site.becomes(*CAMERAS)
    site.flows(30)

    def views_flow() -> bool:
        return sum(len(poses.arrived) for poses in site.poses[-30:]) >= 45

    assert eventually(views_flow), site.diagnostics()
    [event] = site.events("stalled")[before:]
    assert "a message could not be sent" in event["event"]
    place = re.search(r"stacks of all threads are in (\S+)", event["event"])
    assert place is not None and Path(place[1]).parent == site.folder / "logs"
    assert "_run_slots" in Path(place[1]).read_text()


def test_flood_of_garbage_shuts_out_its_camera_and_no_other(site: OddSite) -> None:
    site.without("cam1")
    edge = psutil.Process(site.programs["edge"].pid)
    before, slots, lost = edge.memory_info().rss, len(site.poses), site.status().slots_lost
    keys = str(site.folder / "keys" / "cameras" / "cam1")
    site.start("cam1", sys.executable, str(HERE / "odd_camera.py"), "cam1", site.endpoint, keys)
    began_s = time.monotonic()
    assert eventually(lambda: "invalid messages" in site.camera("cam1").why), site.diagnostics()
    site.flows(40)
    site.send("cam1", signal.SIGTERM)
    assert site.wait("cam1") == 0
    seconds = time.monotonic() - began_s
    site.becomes("cam0", "cam2")
    site.flows(5)
    site.unbroken([poses.slot for poses in site.poses[slots:]], lost)
    assert len(site.poses) - slots > 0.5 * seconds * 20  # the others went on
    assert edge.memory_info().rss - before < QUEUE_BYTES
    site.whole()  # it is let in again once it has behaved for a while


def test_killed_edge_goes_on_where_it_was(site: OddSite) -> None:
    assert eventually(lambda: len(unpack(site.poses[-1].track_ids)) > 0)
    site.flows(50)
    state = site.folder / "state.npz"
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    last = site.poses[-1]
    given = {one for poses in site.poses for one in unpack(poses.track_ids).tolist()}
    _, kept = read_arrays(state)  # what the newest checkpoint holds
    statuses, count = len(site.statuses), len(site.poses)
    site.start_edge()
    assert eventually(lambda: site.events("resumed")), site.diagnostics()
    assert eventually(lambda: len(site.statuses) > statuses), site.diagnostics()
    site.becomes(*CAMERAS)
    back = next(
        status for _, status in site.statuses[statuses:] if all(c.online for c in status.cameras)
    )
    ready = site.statuses[statuses][1]  # its first word, once what it needs is loaded
    assert back.uptime_s - ready.uptime_s < BACK_S, site.diagnostics()
    assert eventually(lambda: len(site.poses) > count + 20), site.diagnostics()
    first = site.poses[count]
    assert last.slot < first.slot < last.slot + AWAY_SLOTS
    site.unbroken([poses.slot for poses in site.poses[count:]], 0)
    # The same slots in the same time, so that the time away is the number of slots left out.
    assert first.time_edge_ns - last.time_edge_ns == round((first.slot - last.slot) * 1e9 / 20)
    # Nobody new has an id that somebody had, be it after the newest checkpoint.
    ids = {one for poses in site.poses[count:] for one in unpack(poses.track_ids).tolist()}
    next_id = int(kept["state.memory.belief.next_id"]) + IDS_LEFT_OUT
    assert max(given) < next_id and all(one >= next_id for one in ids - given)
    assert "state.deficit" in kept
    # One run goes on in the store.
    site.flows(25)
    site.stores(site.poses[-1].slot)
    store, slots = Store(site.folder / "poses.db"), site.stored()
    assert len(store.runs()) == 1 and slots == sorted(set(slots))
    assert any(event["kind"] == "resumed" for event in store.rows("events"))


def test_revoked_camera_is_shut_out_and_an_added_one_let_in(site: OddSite) -> None:
    keys = site.folder / "keys"
    assert commands.run("keys", "revoke", "cam2", "--keys", keys) == 0
    site.becomes("cam0", "cam1")
    since = len(site.statuses)
    site.flows(20)
    assert eventually(lambda: len(site.statuses) > since + 1), site.diagnostics()
    shut_out = [c for c in site.cameras_since(since) if c.camera_id == "cam2"]
    assert not any(c.online for c in shut_out)
    assert shut_out[-1].why == "certificate revoked: e3pose keys add cam2"
    assert eventually(lambda: "does not admit this camera" in site.log("cam2").read_text())
    assert site.programs["cam2"].poll() is None  # it goes on trying
    assert commands.run("keys", "add", "cam2", "--keys", keys) == 0
    site.send("cam2", signal.SIGINT)
    assert site.wait("cam2") == 0
    site.start_camera("cam2")  # with the folder that was carried to it
    site.becomes(*CAMERAS)


def test_interrupt_ends_everybody_cleanly_and_quickly(site: OddSite) -> None:
    for name in ("cam0", "edge", "cam1", "cam2"):  # cameras without an edge end as well
        sent_s = site.send(name, signal.SIGINT)
        assert site.wait(name) == 0
        assert time.monotonic() - sent_s < ENDED_S, name
    assert " slots, " in site.log("edge").read_text()
    assert " frames, " in site.log("cam0").read_text()
