"""One camera placed anew, the others held."""

from __future__ import annotations

import numpy as np
import pytest
from tests.calibrate.people_scenes import knocked, walk

from e3pose.base.errors import InputError
from e3pose.calibrate.people_places import place_one
from e3pose.calibrate.recordings import first_seconds, last_seconds
from e3pose.model.noises import load_noise
from e3pose.model.rotations import angles_between
from e3pose.recording.record import Recording

pytestmark = pytest.mark.slow

NOISE = load_noise("simulated")


@pytest.fixture(scope="module")
def calm() -> Recording:
    return walk(701, people=2, seconds=20.0, fps=5.0)


def test_knocked_camera_is_put_right_and_the_others_stay(calm: Recording) -> None:
    recording = knocked(calm, 2, 5.0, 701, 0.0)
    found = place_one(recording, NOISE, calm.rig, "cam2")
    assert found.degrees == pytest.approx(5.0, abs=0.3)
    assert found.metres < 0.04 and found.inliers > 0.9 and found.error_px < 8
    for i in (0, 1, 3):
        assert np.array_equal(
            found.rig.cameras[i].T_world_camera, calm.rig.cameras[i].T_world_camera
        )
    again = place_one(recording, NOISE, found.rig, "cam2")
    assert again.degrees < 0.1
    turned = angles_between(found.rig.cameras[2].R[None], calm.rig.cameras[2].R[None])
    assert np.degrees(turned[0]) == pytest.approx(found.degrees)


def test_too_little_to_place_it_by_is_an_error(calm: Recording) -> None:
    with pytest.raises(InputError, match="camera cam1: shares"):
        place_one(first_seconds(calm, 0.5), NOISE, calm.rig, "cam1")
    with pytest.raises(InputError, match="cam9"):
        place_one(calm, NOISE, calm.rig, "cam9")


def test_last_seconds_are_the_end(calm: Recording) -> None:
    end = last_seconds(calm, 5.0)
    assert end.num_slots == 25 and end.views[0].slots[0] == 0
    assert np.array_equal(
        end.views[0].keypoints_px[-1], calm.views[0].keypoints_px[-1], equal_nan=True
    )
