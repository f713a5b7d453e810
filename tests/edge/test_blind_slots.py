"""Blind slots of a site in one process: counted and published with their cause."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.edge.one_process import Site, site_at_work
from tests.waiting import eventually

from e3pose.select.policies.base import Selection, Situation

pytestmark = pytest.mark.slow


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with site_at_work(tmp_path) as made:
        yield made


class Rest:
    """Select no camera."""

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        return np.zeros(len(situation.online), dtype=bool)


def counted(site: Site, cause: str) -> int:
    assert site.edge is not None
    return site.edge.status().blind.get(cause, 0)


def test_views_that_get_lost_make_slots_blind_until_they_come_again(site: Site) -> None:
    edge = site.edge
    assert edge is not None
    before = counted(site, "views-missing")
    site.hub.fault = lambda topic, payload: None if topic.endswith("/view") else payload
    assert eventually(lambda: counted(site, "views-missing") >= before + 10)
    site.hub.fault = lambda topic, payload: payload
    assert eventually(lambda: bool(site.poses[-1].arrived))
    status = edge.status()
    assert 0 < status.blind_share < 1 and status.slots > sum(status.blind.values())
    assert all(not poses.blind for poses in site.poses if poses.arrived)
    # Duty is that of the other slots: three cameras in the warm-up, then two.
    assert 2 <= sum(camera.duty for camera in status.cameras) <= 3


def test_site_without_cameras_is_blind_and_its_slots_are_no_rest(site: Site) -> None:
    for node in site.nodes.values():
        node.stop()
    assert eventually(lambda: counted(site, "cameras-offline") >= 10)
    assert site.poses[-1].blind == "cameras-offline"
    for camera_id in site.recording.rig.camera_ids:
        site.start_camera(camera_id)
    assert eventually(lambda: bool(site.poses[-1].arrived))


def test_orders_that_arrive_too_late_make_slots_blind(site: Site) -> None:
    site.hub.delay_s = lambda topic: 0.5 if "/order/" in topic else 0.0
    assert eventually(lambda: counted(site, "orders-late") >= 3)


def test_policy_that_rests_on_purpose_makes_no_slot_blind(site: Site) -> None:
    edge = site.edge
    assert edge is not None

    edge.owner.pipeline = replace(edge.pipeline, policy=Rest())
    here = edge.counts.slots
    assert eventually(lambda: edge.counts.slots > here + 30)
    assert all(not poses.blind and not poses.selected for poses in site.poses[-15:])
