"""Cameras behind a link that loses, delays, and is cut."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.bad_link import BadLink, bad_link
from tests.live.processes import CAMERAS, LiveSite

pytestmark = pytest.mark.live

CUT_S = 10.0


@pytest.fixture(scope="module")
def link() -> Iterator[BadLink]:
    with bad_link() as made:
        yield made


@pytest.fixture(scope="module")
def far_site(
    tmp_path_factory: pytest.TempPathFactory, recording: Path, link: BadLink
) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("far")
    (folder / "recording").symlink_to(recording)
    made = LiveSite(folder, host=link.host, more=("deadline_ms = 400",), inside=link.inside)
    made.camera_port = link.port_for(made.port)
    with made.at_work(link.host):
        yield made


def test_loss_and_jitter_lose_views_but_no_slot(far_site: LiveSite, link: BadLink) -> None:
    link.jitter()
    far_site.flows(60, 15.0)  # the lead and TCP find their way
    begin, missed = len(far_site.poses), sum(c.lost + c.late for c in far_site.status().cameras)
    far_site.flows(100, 15.0)
    slots = [poses.slot for poses in far_site.poses[begin:]]
    assert slots == list(range(slots[0], slots[0] + len(slots)))
    assert far_site.status().slots_lost == 0
    lost = sum(c.lost + c.late for c in far_site.status().cameras) - missed
    ordered = 2 * len(slots)
    assert lost < 0.5 * ordered, far_site.told()
    assert len(far_site.online()) >= 2
    link.heal()
    far_site.becomes(*CAMERAS)


def test_partition_of_ten_seconds_heals_by_itself(far_site: LiveSite, link: BadLink) -> None:
    lost = far_site.status().slots_lost
    link.cut()
    cut_s = time.monotonic()
    far_site.becomes(seconds=4.0)
    assert time.monotonic() - cut_s < 2.5
    count = len(far_site.poses)
    time.sleep(CUT_S - (time.monotonic() - cut_s))
    assert len(far_site.poses) - count > 5 * 20  # slots go on, with nobody
    link.heal()
    far_site.becomes(*CAMERAS, seconds=8.0)  # TCP tries again after 1, 2, 4 seconds
    far_site.flows(20)
    assert far_site.status().slots_lost == lost
