"""What a replay tells of the noise that it assumed and of what it learned."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from e3pose.energy.profiles import load_profile
from e3pose.evaluate.figures import as_json
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import summarise
from e3pose.evaluate.tables import noise_lines
from e3pose.recording import Recording
from e3pose.settings.parts import noise_warning
from e3pose.simulate import SceneSettings, simulate


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings(scene="ring", seconds=6.0, fps=12.5), 705)


def test_unknown_detector_is_reported(recording: Recording) -> None:
    unknown = replace(recording, detector="a network of our own")
    assert "no noise model for this detector" in noise_warning(unknown, ReplaySettings())
    assert noise_warning(unknown, ReplaySettings(noise="openpose")) == ""
    assert noise_warning(unknown, ReplaySettings(pipeline="paper")) == ""
    assert noise_warning(recording, ReplaySettings()) == ""


def test_summary_has_what_was_learned(recording: Recording) -> None:
    noisy = recording.rig.camera_ids[1]
    views = list(recording.views)
    keypoints_px = views[1].keypoints_px.copy()
    keypoints_px[::2] += 12.0  # its keypoints jump to and fro
    keypoints_px[1::2] -= 12.0
    views[1] = replace(views[1], keypoints_px=keypoints_px)
    jumpy = replace(recording, views=tuple(views))
    settings = ReplaySettings(policy="all", num_selected=5)
    summary = summarise(jumpy, settings, list(replay(jumpy, settings)), load_profile("generic"))
    factors = json.loads(json.dumps(as_json(summary)))["noise"]["factors"]
    assert max(factors, key=factors.get) == noisy
    assert [line for line in noise_lines(summary) if line.startswith(f"{noisy}: keypoint noise ")]
    assert all(line.endswith("x what simulated states") for line in noise_lines(summary))
