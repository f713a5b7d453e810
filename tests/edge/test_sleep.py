"""A site in one process whose cameras are told to sleep, also where clocks are set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.edge.one_process import QuickClock, Site, site_at_work
from tests.waiting import eventually

from e3pose.camera.live_source import RecordedSource
from e3pose.edge import server
from e3pose.edge.camera_state import State
from e3pose.pipeline import step

pytestmark = [pytest.mark.slow, pytest.mark.timed]

SLEEP_SLOTS = 80  # of a twentieth of a second


class Planner:
    """In place of a planner: sends cameras to sleep when asked to."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def step(self, pipeline: Any, state: Any, views: Any, online: Any, *more: Any) -> Any:
        until = state.asleep_until.copy()
        while self.asked:
            until[self.asked.pop()] = state.slot + pipeline.lead_slots + SLEEP_SLOTS
        return step(pipeline, replace(state, asleep_until=until), views, online, *more)


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch) -> Planner:
    made = Planner()
    monkeypatch.setattr(server, "step", made.step)
    return made


@pytest.fixture
def site(tmp_path: Path, planner: Planner) -> Iterator[Site]:
    with site_at_work(tmp_path) as made:
        for node in made.nodes.values():
            node.settings = replace(node.settings, rests=("asleep",))
        edge = made.edge
        # Hellos come every two seconds.
        assert eventually(
            lambda: all(c.hello is not None and c.hello.rests for c in edge.inbox.cameras)
        )
        yield made


def asleep(site: Site, *cameras: int) -> bool:
    edge = site.edge
    return bool((edge.inbox.states()[list(cameras)] == State.ASLEEP).all())


def test_source_is_closed_and_nothing_is_sent_until_the_camera_is_back(
    site: Site, planner: Planner
) -> None:
    edge = site.edge
    sent: list[str] = []
    planner.asked.append(2)
    assert eventually(lambda: site.nodes["cam2"].mode == "asleep")
    frames = site.nodes["cam2"].counts.captured
    until = int(edge.state.asleep_until[2])
    site.hub.join().subscribe("e3pose/lab/camera/cam2/*", lambda topic, _: sent.append(topic))
    assert eventually(lambda: edge.state.slot > until - SLEEP_SLOTS // 2)
    assert not sent and site.nodes["cam2"].counts.captured == frames
    assert not site.camera("cam2").online and site.camera("cam2").mode == "asleep"
    assert eventually(lambda: site.camera("cam2").online and bool(sent))
    views = edge.gather.views[2]
    assert eventually(lambda: edge.gather.views[2] > views)
    assert not site.was_lost("cam2")
    spent_ns = site.nodes["cam2"].modes.times().spent_ns
    assert spent_ns["asleep"] > 1e9 and spent_ns["active"] > 0
    blind = dict(edge.counts.blind)
    planner.asked += [0, 1, 2]
    assert eventually(lambda: asleep(site, 0, 1, 2))
    slots = edge.counts.slots
    assert eventually(lambda: edge.counts.slots > slots + 10)
    assert edge.counts.blind == blind  # though nobody looks
    assert eventually(lambda: len(site.online()) == 3)


def test_edge_whose_clock_was_set_finds_its_sleepers_again(site: Site, planner: Planner) -> None:
    edge = site.edge
    planner.asked.append(2)
    assert eventually(lambda: asleep(site, 2))
    edge.stop()
    site.clock = QuickClock(site.clock.origin_ns + 3600 * 10**9)
    again = site.start_edge()
    assert eventually(lambda: again.counts.slots > 10)
    assert any("since the last slot" in e.message for e in site.events if e.kind == "clock")
    assert eventually(lambda: len(site.online()) == 3)
    assert eventually(lambda: again.gather.views.min() > 0)


def test_camera_whose_clock_is_set_in_its_sleep_comes_back(site: Site, planner: Planner) -> None:
    node = site.nodes["cam2"]
    planner.asked.append(2)
    assert eventually(lambda: node.mode == "asleep")
    node.clock = QuickClock(site.clock.origin_ns - 3600 * 10**9)
    node.source = RecordedSource(site.recording, "cam2", node.clock)  # the one before is closed
    assert eventually(lambda: node.mode != "asleep" and site.camera("cam2").online)
    edge = site.edge
    views = edge.gather.views[2]
    assert eventually(lambda: edge.gather.views[2] > views)


def test_camera_that_is_started_again_in_its_sleep_goes_on_sleeping(
    site: Site, planner: Planner
) -> None:
    planner.asked.append(2)
    assert eventually(lambda: site.nodes["cam2"].mode == "asleep")
    site.nodes["cam2"].stop()
    again = site.start_camera("cam2", rests=("asleep",))
    assert eventually(lambda: again.mode == "asleep")
    assert eventually(lambda: site.camera("cam2").online)
    assert not site.was_lost("cam2")


def test_camera_that_may_not_sleep_goes_on(site: Site, planner: Planner) -> None:
    edge = site.edge
    site.nodes["cam1"].settings = replace(site.nodes["cam1"].settings, rests=())
    assert eventually(lambda: edge.inbox.cameras[1].hello.rests == ())  # type: ignore[union-attr]
    planner.asked.append(1)
    slots = edge.counts.slots
    assert eventually(lambda: edge.counts.slots > slots + 20)
    assert edge.state.asleep_until[1] == 0 and "cam1" in site.online()
    views = np.array(edge.gather.views)
    assert eventually(lambda: edge.gather.views[1] > views[1])
