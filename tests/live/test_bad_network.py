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
