"""What a calibration from people says of its own errors, and of rigs that it judges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.calibrate.people_scenes import decentred, disturbed, walk, without_calibration

from e3pose.calibrate.from_people import solve_people
from e3pose.calibrate.judge import judge
from e3pose.calibrate.moved_cameras import distances
from e3pose.calibrate.uncertainty import camera_errors, likely_rigs
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.scenes import GUESSES

pytestmark = pytest.mark.slow

WALK = SceneSettings(people=2, seconds=8.0, fps=5.0, cameras=4)
CASES = {
    "ring": (WALK, 711),
    "errors that follow the view": (replace(WALK, detector=GUESSES), 712),
    "six cameras": (replace(WALK, cameras=6, people=3), 713),
}


@pytest.mark.parametrize(
    ("name", "lens"),
    [
        ("ring", "unknown"),
        pytest.param("errors that follow the view", "known", marks=pytest.mark.nightly),
        pytest.param("ring", "known", marks=pytest.mark.nightly),
        pytest.param("errors that follow the view", "unknown", marks=pytest.mark.nightly),
        pytest.param("six cameras", "known", marks=pytest.mark.nightly),
        pytest.param("six cameras", "unknown", marks=pytest.mark.nightly),
    ],
)
def test_truth_lies_within_twice_the_expected_error(name: str, lens: str) -> None:
    settings, seed = CASES[name]
    true = simulate(settings, seed)
    if lens == "unknown":  # of a lens whose axis is not in the middle of its image
        true = decentred(true, 0.015, seed)
    recording = true if lens == "known" else without_calibration(true)
    found = solve_people(recording, load_noise(detector_of(true)), None)
    # Compared with the truth, `moved` is the error and `sure` what was expected of it.
    errors = camera_errors(true.rig, found, likely_rigs(found, recording.fps))
    assert (errors.moved_deg < 2 * errors.sure_deg).all()
    assert (errors.moved_mm < 2 * errors.sure_mm).all()
    assert (errors.moved_rays_deg < 2 * errors.sure_rays_deg).all()
    assert np.median(errors.sure_rays_deg) < 0.6
    assert np.median(errors.sure_deg) < (0.4 if lens == "known" else 2.0)
    assert np.median(errors.sure_mm) < (50 if lens == "known" else 75)


def test_errors_are_unknown_where_people_put_a_camera_elsewhere() -> None:
    true = simulate(WALK, 714)
    found = solve_people(true, load_noise("simulated"), None)
    likely = likely_rigs(found, true.fps)
    turned = true.rig.cameras[0]
    turned = replace(turned, T_world_camera=turned.T_world_camera @ np.diag([-1.0, 1, -1, 1]))
    far = replace(true.rig, cameras=(turned, *true.rig.cameras[1:]))
    assert camera_errors(true.rig, found, likely).expected_text(0) != "unknown"
    assert "rays" not in camera_errors(true.rig, found, likely).expected_text(0)
    assert camera_errors(far, found, likely).expected_text(0) == "unknown"
    pair = true.rig.subset([0, 1])
    assert camera_errors(pair, found, likely).expected_text(0) == "unknown"
    assert distances(true.rig, true.rig)[0].max() < 1e-6


NOISE = load_noise("simulated")


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
