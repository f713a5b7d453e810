"""Cameras behind a link that loses, delays, and is cut."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.bad_link import BadLink, bad_link
from tests.live.processes import CAMERAS, LiveSite
from tests.waiting import eventually

pytestmark = pytest.mark.timed

CUT_S = 5.0
NOTICED_S = 2.0
BACK_S = 20.0
# Of a good link, as of one that is busy; the deadline of views takes eight slots, jitter some more.
SHORT_LEAD, LONG_LEAD = 5, 8


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
    made = LiveSite(
        folder,
        host=link.host,
        more=("deadline_ms = 400",),
        tables=("[store]", 'path = "poses.db"'),
        inside=link.inside,
    )
    made.camera_port = link.port_for(made.port)
    with made.at_work(link.host):
        yield made


@pytest.mark.nightly
def test_loss_and_jitter_lose_views_but_no_slot(far_site: LiveSite, link: BadLink) -> None:
    begin, given_up = len(far_site.poses), far_site.status().slots_lost
    useless = len(far_site.events("camera-useless"))  # of a try before this one
    link.jitter()

    def come() -> bool:
        """Return whether most views of 60 slots come in time: not before the lead has followed."""
        missed = sum(c.lost + c.late for c in far_site.status().cameras)
        far_site.flows(60)
        missed = sum(c.lost + c.late for c in far_site.status().cameras) - missed
        return missed < 0.25 * 2 * 60

    assert eventually(come, 60.0), far_site.diagnostics()
    far_site.unbroken([poses.slot for poses in far_site.poses[begin:]], given_up)
    far_site.becomes(*CAMERAS)
    told = far_site.events("camera-useless")[useless:]
    assert not told, far_site.diagnostics()
    link.heal()
    far_site.becomes(*CAMERAS)


@pytest.mark.nightly
def test_lead_is_back_in_20_seconds_after_the_start_and_after_jitter(
    far_site: LiveSite, link: BadLink
) -> None:
    def lead() -> int:
        return far_site.status().lead

    assert eventually(lambda: lead() <= SHORT_LEAD), far_site.diagnostics()
    link.jitter()
    assert eventually(lambda: lead() >= LONG_LEAD), far_site.diagnostics()
    link.heal()
    healed_s = time.monotonic()
    assert eventually(lambda: lead() <= SHORT_LEAD), far_site.diagnostics()
    took_s = time.monotonic() - healed_s
    assert took_s < BACK_S + 3.0, "a report of half a second, a status of one, and a busy machine"


def test_partition_of_seconds_heals_by_itself(far_site: LiveSite, link: BadLink) -> None:
    lost, since, begin = far_site.status().slots_lost, len(far_site.statuses), len(far_site.poses)
    link.cut()
    cut_s = time.monotonic()
    far_site.becomes()
    assert max(far_site.longest_silence_s(camera, since) for camera in CAMERAS) < NOTICED_S
    far_site.flows(20)  # slots go on, with nobody
    assert eventually(lambda: time.monotonic() - cut_s >= CUT_S)
    link.heal()
    far_site.becomes(*CAMERAS)  # TCP tries again after 1, 2, 4 seconds
    far_site.flows(20)
    far_site.unbroken([poses.slot for poses in far_site.poses[begin:]], lost)
