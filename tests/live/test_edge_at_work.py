"""An edge that is killed and restarted, whose list of certificates changes, and that ends."""

from __future__ import annotations

import signal
import time

import pytest
from tests.cli import commands
from tests.live.processes import CAMERAS, LiveSite
from tests.waiting import eventually

from e3pose.edge.checkpoint import read_arrays
from e3pose.edge.server import IDS_LEFT_OUT
from e3pose.store import Store
from e3pose.wire.arrays import unpack

pytestmark = [pytest.mark.live, pytest.mark.timed]

BACK_S = 3.0
ENDED_S = 6.0  # a second on a machine that does nothing else
AWAY_SLOTS = 600  # half a minute: a slot that was numbered anew would be far from that


def test_killed_edge_goes_on_where_it_was(site: LiveSite) -> None:
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


def test_one_run_goes_on_in_the_store(site: LiveSite) -> None:
    site.flows(25)
    site.stores(site.poses[-1].slot)
    store, slots = Store(site.folder / "poses.db"), site.stored()
    assert len(store.runs()) == 1
    assert len(set(slots)) == len(slots) and slots == sorted(slots)
    assert any(event["kind"] == "resumed" for event in store.rows("events"))


def test_revoked_camera_is_shut_out_and_an_added_one_let_in(site: LiveSite) -> None:
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


def test_damaged_list_of_certificates_changes_nothing(site: LiveSite) -> None:
    path = site.folder / "keys" / "keys.toml"
    good = path.read_text()
    path.write_text("no list [")
    assert eventually(lambda: "cannot reload the certificates" in site.diagnostics())
    site.flows(10)
    path.write_text(good)
    site.becomes(*CAMERAS)
    site.flows(10)


def test_interrupt_ends_everybody_cleanly_and_quickly(site: LiveSite) -> None:
    for name in ("cam0", "edge", "cam1", "cam2"):  # cameras without an edge end as well
        sent_s = site.send(name, signal.SIGINT)
        assert site.wait(name) == 0
        assert time.monotonic() - sent_s < ENDED_S, name
    assert " slots, " in site.log("edge").read_text()
    assert " frames, " in site.log("cam0").read_text()
