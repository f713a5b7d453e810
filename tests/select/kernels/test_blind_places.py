"""A camera is worth as much as it is likely to show somebody."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.estimate.filter import Belief, Model, outlook
from e3pose.estimate.filter import blindness as blind
from e3pose.estimate.filter.blindness import chance
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.select.kernels.foresight import INFORMATION_RATIO, worth
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")

W = INFORMATION_RATIO


def test_plain_sight_changes_nothing_and_a_wall_leaves_nothing() -> None:
    assert worth(1.0) == pytest.approx(1.0)
    assert worth(0.0) == 0.0


def test_a_chance_is_worth_the_mean_of_the_logarithms() -> None:
    for p in (0.1, 0.5, 0.9):
        assert np.log(1 + W * worth(p)) == pytest.approx(p * np.log(1 + W))


def test_two_half_chances_are_worth_less_than_one_sure_view() -> None:
    assert 2 * worth(0.5) < 0.2


def test_a_camera_that_never_showed_the_person_is_expected_to_show_nobody_there() -> None:
    recording = simulate(SceneSettings("crossing", people=1, seconds=6), seed=3)
    model = Model(recording.rig, recording.skeleton, SIMULATED)
    kernel, belief = StepKernel(), Belief.empty(model)
    assert outlook(model, belief, 0.1).expected.shows.shape == (0, 5)
    for slot in range(recording.num_slots):
        views = {c: v for c in range(5) if (v := recording.view(slot, c)) is not None}
        views[2] = Poses2D.empty(17)
        belief, _ = kernel(model, belief, views, slot * recording.interval_s)
    shows = outlook(model, belief, 0.0).expected.shows[0]
    assert shows[2] < 0.35
    assert np.delete(shows, 2).min() > 0.8
    # Nobody was ever where the person is said to be in an hour.
    far = [
        chance(detection_map, np.array([14.0, 14.0]), model.corner_m)
        for detection_map in belief.detection_map
    ]
    np.testing.assert_allclose(far, blind.PLAIN)
