"""A camera is worth as much as it is likely to show somebody."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.estimate.base import Outlook
from e3pose.estimate.filter import Belief, Model, outlook
from e3pose.estimate.filter import blindness as blind
from e3pose.estimate.filter.kernels.blindness import chance
from e3pose.estimate.filter.kernels.step import StepKernel
from e3pose.model.noise import ErrorMemory
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.select.blind_places import INFORMATION_RATIO, discount_blind_cameras
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")

W = INFORMATION_RATIO


def people(delivered: list[float], shows: list[float]) -> Outlook:
    count = len(delivered)
    return Outlook(
        track_ids=np.array([7], dtype=np.int64),
        confirmed=np.ones(1, dtype=bool),
        joints_m=np.zeros((1, 17, 3)),
        covariance=np.broadcast_to(1e-4 * np.eye(6), (1, 17, 6, 6)),
        drift_m2ps3=np.zeros((1, 17)),
        velocity_lasts_s=np.full(17, 0.8),
        has_memory=True,
        delivered=np.array([delivered]),
        shows=np.array([shows]),
        last_seen_s=np.zeros((1, count)),
        needed=np.zeros((1, count), dtype=bool),
        sigma_px=np.full(count, 5.0),
        memory=ErrorMemory(),
        unexplained=np.zeros(count, dtype=np.int64),
        unexplained_s=np.full(count, np.inf),
        wait_s=0.14,
    )


def expected(delivered: list[float], shows: list[float]) -> NDArray[np.float64]:
    return np.asarray(discount_blind_cameras(people(delivered, shows)).delivered[0])


def test_plain_sight_changes_nothing_and_a_wall_leaves_nothing() -> None:
    assert expected([0.5, 0.9, 0.1], [1.0, 1.0, 0.0]) == pytest.approx([0.5, 0.9, 0.0])


def test_a_chance_is_worth_the_mean_of_the_logarithms() -> None:
    for p in (0.1, 0.5, 0.9):
        share = expected([1.0], [p])[0]
        assert np.log(1 + W * share) == pytest.approx(p * np.log(1 + W))


def test_two_half_chances_are_worth_less_than_one_sure_view() -> None:
    assert 2 * expected([1.0], [0.5])[0] < 0.2


def test_a_camera_that_never_showed_the_person_is_expected_to_show_nobody_there() -> None:
    recording = simulate(SceneSettings("crossing", people=1, seconds=6), seed=3)
    model = Model(recording.rig, recording.skeleton, SIMULATED)
    kernel, belief = StepKernel(), Belief.empty(model)
    assert outlook(model, belief, 0.1).shows.shape == (0, 5)
    for slot in range(recording.num_slots):
        views = {c: v for c in range(5) if (v := recording.view(slot, c)) is not None}
        views[2] = Poses2D.empty(17)
        belief, _ = kernel(model, belief, views, slot * recording.interval_s)
    shows = outlook(model, belief, 0.0).shows[0]
    assert shows[2] < 0.35
    assert np.delete(shows, 2).min() > 0.8
    # Nobody was ever where the person is said to be in an hour.
    far = [
        chance(detection_map, np.array([14.0, 14.0]), model.corner_m)
        for detection_map in belief.detection_map
    ]
    np.testing.assert_allclose(far, blind.PLAIN)
