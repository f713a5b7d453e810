"""Cameras that die, freeze, come back, know the time badly, lie, shout, or run out of battery."""

from __future__ import annotations

import signal
import time

import psutil
import pytest
from tests.cli import commands
from tests.live.processes import CAMERAS, LiveSite
from tests.waiting import eventually

from e3pose.store import Store
from e3pose.wire.access import VIEW_BYTES

pytestmark = [pytest.mark.live, pytest.mark.timed]

NOTICED_S = 2.0
QUEUE_BYTES = 256 * VIEW_BYTES  # what the network keeps at most until it is read


def looked(site: LiveSite, since: int) -> list[float]:
    """Return how large a share of the slots since one each camera was selected in."""
    rows = [row for row in Store(site.folder / "poses.db").rows("slots") if row["slot"] >= since]
    assert len(rows) > 10
    return [
        sum(list(row["selected"])[index] in (1, "1") for row in rows) / len(rows)
        for index in range(len(CAMERAS))
    ]


def not_in_time(site: LiveSite, camera_id: str) -> int:
    """Return how many views of a camera were asked for and were not there in time."""
    camera = site.camera(camera_id)
    return camera.lost + camera.late


def test_slots_follow_each_other(site: LiveSite) -> None:
    site.whole()
    begin, lost = len(site.poses), site.status().slots_lost
    site.flows(30)
    site.unbroken([poses.slot for poses in site.poses[begin:]], lost)


def test_top_and_check_look_at_it(
    site: LiveSite, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    site.whole()
    code, said = commands.run("top", site.path, "--once"), capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert "3/3 cameras" in said.out and all(camera_id in said.out for camera_id in CAMERAS)
    code, said = commands.run("check", site.path), capsys.readouterr()
    assert (code, said.err) == (0, "")
    assert "running, slot" in said.out and said.out.count("connected, clock") == 3


def test_killed_camera_is_noticed_and_replaced_by_others(site: LiveSite) -> None:
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


def test_frozen_camera_is_noticed_and_comes_back(site: LiveSite) -> None:
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


def test_clock_that_is_wrong_drifts_and_is_set_costs_nothing_for_long(site: LiveSite) -> None:
    site.whole()
    site.send("cam1", signal.SIGINT)
    assert site.wait("cam1") == 0
    site.becomes("cam0", "cam2")
    site.start_odd_camera("cam1", "clock")
    site.becomes(*CAMERAS)
    # An hour behind; frames carry that time, and the views are in their slots all the same.
    assert eventually(lambda: abs(site.camera("cam1").clock_offset_ms - 3600e3) < 20)
    lost = not_in_time(site, "cam1")
    site.flows(20)
    assert not_in_time(site, "cam1") - lost <= 6  # of 13 or so
    # Then its clock is set by half a minute.
    assert eventually(lambda: abs(site.camera("cam1").clock_offset_ms - 3570e3) < 20)
    site.becomes(*CAMERAS)
    site.flows(10)
    lost = not_in_time(site, "cam1")
    site.flows(40)
    assert not_in_time(site, "cam1") - lost <= 13, site.diagnostics()  # of 26 or so
    site.send("cam1", signal.SIGTERM)
    assert site.wait("cam1") == 0


def test_empty_battery_is_noticed(site: LiveSite) -> None:
    site.without("cam1")
    site.start_camera("cam1", "--battery-wh", "0.015")  # 54 J, a few seconds of its profile
    assert eventually(lambda: site.camera("cam1").online), site.diagnostics()
    assert eventually(lambda: site.camera("cam1").why.startswith("battery empty")), (
        site.diagnostics()
    )
    assert site.camera("cam1").battery == 0.0
    site.flows(10)
    site.without("cam1")


def test_flood_of_garbage_shuts_out_its_camera_and_no_other(site: LiveSite) -> None:
    site.without("cam1")
    edge = psutil.Process(site.programs["edge"].pid)
    before, slots, lost = edge.memory_info().rss, len(site.poses), site.status().slots_lost
    site.start_odd_camera("cam1", "flood")
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
