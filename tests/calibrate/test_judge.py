"""Calibrations judged by short recordings of several people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.calibrate.people_scenes import disturbed, walk

from e3pose.calibrate.judge import judge
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.simulate import SceneSettings, simulate

NOISE = load_noise("simulated")

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("people", "cameras", "seconds", "seed"),
    [(2, 4, 2.0, 704), (3, 4, 8.0, 701), (3, 6, 1.0, 703), (4, 4, 4.0, 701)],
)
def test_good_rig_is_not_blamed_for_people_who_cross(
    people: int, cameras: int, seconds: float, seed: int
) -> None:
    found = judge(walk(seed, people, seconds, 12.5, cameras), NOISE)
    assert np.nanmax(found.errors_px) < 12  # wrong people would be a hundred pixels off


def test_camera_that_was_turned_is_found_in_a_few_seconds() -> None:
    recording = walk(704, people=2, seconds=4.0, fps=12.5)
    turned = disturbed(recording.rig, 3.0, 0.0, 704).cameras[1]
    cameras = [turned if i == 1 else camera for i, camera in enumerate(recording.rig.cameras)]
    found = judge(replace(recording, rig=Rig(tuple(cameras))), NOISE)
    assert (
        found.errors_px.argmax() == 1 and found.errors_px[1] > 4 * found.errors_px[[0, 2, 3]].max()
    )


@pytest.mark.nightly
def test_true_rig_of_an_operating_room_raises_no_alarm() -> None:
    # Staff who stand round a table, keypoints of another detector than declared, 6 per second.
    recording = simulate(SceneSettings(scene="operating-room", seconds=15.0), seed=705)
    found = judge(recording, load_noise(detector_of(recording)))
    assert not any("would fit" in words for words in found.next_steps)
    unknown = np.isnan(found.errors.moved_deg)
    assert (unknown | (found.errors.moved_deg < 2 * found.errors.sure_deg)).all()
    assert (unknown | (found.errors.expected_deg < 3)).all()
