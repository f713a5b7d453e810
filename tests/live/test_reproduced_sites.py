"""Sites that `e3pose reproduce` runs: their memory, their slots through a slow link, and faults."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import Example
from e3pose_lab.reproduce.site_memory import MemoryAsked, site_memory
from e3pose_lab.reproduce.site_run import running_site
from e3pose_lab.reproduce.sources import Sources


@pytest.mark.nightly
def test_memory_is_that_of_the_processes() -> None:
    found = site_memory(Sources(), MemoryAsked("e3pose", 2, cameras=2, selected=2, seconds=1.0))
    assert 20 < found.camera_pss <= found.camera_rss < 1000  # an interpreter with numpy
    assert 20 < found.edge_pss <= found.edge_rss < 4000
    assert 0 < found.people <= 4


@pytest.mark.nightly
def test_orders_ahead_of_time_hide_a_slow_link(tmp_path: Path) -> None:
    recording = simulate(SceneSettings("ring", people=1, seconds=4.0, fps=10.0, cameras=2), 0)
    save_recording(recording, tmp_path / "recording")
    sources = dict.fromkeys(recording.rig.camera_ids, "recorded:recording")
    far = Example("far", sources, 10.0, "coco17", cameras=2, deadline_ms=1000.0)
    with running_site(tmp_path, recording.rig, far, 0.4) as run:

        def whole() -> bool:
            return any(arrived == 2 for _, _, arrived in list(run.slots.values()))

        run.wait(whole, 120.0, "a slot with both views")
        assert run.follower.status is not None
        assert run.follower.status.lead >= 4  # slots of 100 ms, for orders to be there in time


def test_a_site_that_does_not_run_says_why(tmp_path: Path) -> None:
    rig = looking((3.0, 0.0), (0.0, 3.0))
    nothing = Example("broken", dict.fromkeys(rig.camera_ids, "none.mp4"), 10.0, "coco17")
    with pytest.raises(InputError, match=r"ended.*none\.mp4"), running_site(tmp_path, rig, nothing):
        pass
