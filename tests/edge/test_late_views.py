"""Air that delays and loses: cameras stay selected while their views come at all."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.edge.one_process import Site, site_at_work
from tests.waiting import eventually

pytestmark = pytest.mark.timed

DEADLINE_S = 0.1


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with site_at_work(tmp_path, deadline_s=DEADLINE_S, num_selected=3) as made:
        yield made


def test_jitter_and_loss_leave_no_camera_out(site: Site) -> None:
    """Views take 50 to 150 ms of the 100 that the slot waits: half of them are late."""
    edge, rng = site.edge, random.Random(3)
    site.hub.delay_s = lambda topic: rng.uniform(0.05, 0.15)
    site.hub.fault = lambda topic, payload: None if rng.random() < 0.05 else payload
    late, slot = edge.gather.late.copy(), edge.state.slot
    left_out: list[bool] = []

    def looked() -> bool:
        state = edge.state
        left_out.extend((~state.silence.answering(state.slot)).tolist())
        return bool(state.slot >= slot + 120 and (edge.gather.late > late + 10).all())

    assert eventually(looked)
    assert np.mean(left_out) < 0.1, site.events  # a half, if what comes late does not count


def test_camera_that_is_always_late_is_left_out_reported_and_taken_back(site: Site) -> None:
    edge = site.edge
    site.hub.delay_s = lambda topic: 0.5 if topic.endswith("cam1/view") else 0.0
    assert eventually(lambda: site.reported("camera-useless", "cam1")), site.events
    word = next(e.message for e in reversed(site.events) if e.kind == "camera-useless")
    assert word.startswith("cam1: views arrive too late, ") and word.endswith(" ms after capture")
    assert int(word.split(", ")[1].split()[0]) >= 500
    assert "too late" in site.camera("cam1").why and site.camera("cam1").online
    assert site.camera("cam1").late > 0
    seen = edge.counts.slots  # while it is left out, nobody waits for it
    assert eventually(lambda: not edge.state.selections[:, 1].any())
    assert eventually(lambda: edge.counts.slots > seen + 5)
    site.hub.delay_s = lambda topic: 0.0
    assert eventually(lambda: site.reported("camera-useful", "cam1")), site.events
    assert eventually(lambda: site.camera("cam1").why == "")  # what it missed may be told a while
