"""What all cameras of a site see becomes a recording, whether they are calibrated or not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.base.clock import WallClock
from e3pose.camera.base import NodeSettings
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import RecordedSource
from e3pose.edge.record_server import RecordingPlan, RecordServer
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration.world import assumed_rig
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

FPS = 20.0


@pytest.fixture(scope="module")
def shown() -> Recording:
    return simulate(SceneSettings(people=2, seconds=3.0, fps=FPS, cameras=2), seed=3)


def test_recording_holds_what_the_cameras_saw(shown: Recording, tmp_path: Path) -> None:
    hub, clock = Hub(), WallClock()
    unknown = assumed_rig(dict.fromkeys(shown.rig.camera_ids, (64, 48)))
    plan = RecordingPlan(
        tmp_path / "walk", "lab", unknown, shown.skeleton, FPS, detector="openpose", for_s=1.5
    )
    nodes = [
        CameraNode(
            NodeSettings("lab", camera_id, shown.skeleton.joints),
            RecordedSource(shown, camera_id, clock),
            None,
            hub.join(),
            clock,
        )
        for camera_id in shown.rig.camera_ids
    ]
    with RecordServer(plan, hub.join(), clock) as server:
        assert set(server.problems()) == set(shown.rig.camera_ids)
        for node in nodes:
            node.start()
        try:
            assert eventually(lambda: not server.running())
        finally:
            for node in nodes:
                node.stop()
    assert server.threads.failure is None and server.written == tmp_path / "walk"
    recording = load_recording(tmp_path / "walk")
    assert 20 <= recording.num_slots <= 30 and recording.detector == "openpose"
    assert not recording.rig.placed
    assert [c.image_size for c in recording.rig.cameras] == [
        c.image_size for c in shown.rig.cameras
    ]
    assert recording.processor.keys() == set(shown.rig.camera_ids)  # by their heartbeats
    assert all(each.frame_s > 0 and each.looks > 5 for each in recording.processor.values())
    for index, series in enumerate(recording.views):
        assert server.views[index] == len(series.slots) > 10
        assert server.people[index] == len(series.scores)
        assert (np.abs(series.times_s - series.slots / FPS) < 1 / FPS).all()
        known = np.nan_to_num(shown.views[index].keypoints_px)
        for person in np.nan_to_num(series.keypoints_px):  # travels as float32
            assert np.abs(known - person).max(axis=(1, 2)).min() < 0.01


def test_recording_that_is_stopped_before_a_camera_came_is_none(
    shown: Recording, tmp_path: Path
) -> None:
    plan = RecordingPlan(tmp_path / "walk", "lab", shown.rig, shown.skeleton, FPS)
    with RecordServer(plan, Hub().join(), WallClock()) as server:
        assert set(server.problems().values()) == {"never connected"}
    assert server.written is None and not list(tmp_path.iterdir())
