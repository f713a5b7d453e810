"""Whether expected errors are honest, and what a duty saves on the paper's devices."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.energy.profiles import DeviceProfile, load_profile
from e3pose.evaluate.figures import (
    PAPER_SAVINGS,
    Energy,
    Expected,
    energy_figures,
    expected_figures,
    modelled_watts,
)
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17, PANOPTIC19, Skeleton
from e3pose.model.uncertainty import TAILS
from e3pose.pipeline import Reasons, SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries

NUM_SLOTS, CAMERAS = 200, ("a", "b", "c", "d", "e")
BODY = np.random.default_rng(1).normal(size=(17, 3))


def recording(skeleton: Skeleton = COCO17) -> Recording:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    cameras = tuple(
        Camera.from_world_to_camera(name, (640, 480), K, np.eye(3), [float(i), 0, 5])
        for i, name in enumerate(CAMERAS)
    )
    lost = ViewSeries.from_views([], [], [], 17)
    joints = np.zeros((len(skeleton), 3))
    joints[: len(BODY)] = BODY
    truth = Truth(
        skeleton, ("anna",), np.broadcast_to(joints, (NUM_SLOTS, 1, *joints.shape)).copy()
    )
    return Recording("test", Rig(cameras), 10.0, NUM_SLOTS, COCO17, (lost,) * 5, truth=truth)


def records(sigma_m: float, claimed_m: float, on: int = 2) -> list[SlotRecord]:
    """Make an estimator that errs by `sigma_m` per axis and states `claimed_m`.

    Its errors have the tails that `distance_within_m` expects, and the mean of normal ones.
    """
    rng = np.random.default_rng(2)
    found = []
    for slot in range(NUM_SLOTS):
        selected = np.arange(5) < on
        tails = np.sqrt(TAILS / rng.chisquare(TAILS, size=(1, 17, 1))) / np.sqrt(np.pi / 2)
        joints = BODY[None] + tails * rng.normal(scale=sigma_m, size=(1, 17, 3))
        people = People(np.array([3]), joints, sigma_m=np.full((1, 17), claimed_m))
        reasons, zero = Reasons(slot + 1, np.zeros(5), np.zeros(5), 0.03), np.zeros(5)
        there = slot, slot / 10, selected, selected, people, zero, zero, selected
        found.append(SlotRecord(*there, reasons=reasons))
    return found


def test_an_honest_estimator_covers_nine_of_ten() -> None:
    figures = expected_figures(recording(), records(0.02, 0.02))
    assert figures.error_mm == pytest.approx(20 * 1.595769, rel=1e-5)
    assert figures.matched_mm == pytest.approx(figures.error_mm)
    assert figures.actual_mm == pytest.approx(figures.error_mm, rel=0.03)
    assert figures.coverage_90 == pytest.approx(90, abs=1.5)
    assert figures.foreseen_mm == pytest.approx(30)


@pytest.mark.parametrize(("claimed_m", "low", "high"), [(0.01, 20, 60), (0.04, 98, 100)])
def test_one_that_claims_too_much_or_too_little_is_found_out(
    claimed_m: float, low: float, high: float
) -> None:
    figures = expected_figures(recording(), records(0.02, claimed_m))
    assert figures.coverage_90 is not None and low < figures.coverage_90 <= high


def test_another_skeleton_or_no_covariance_says_less() -> None:
    assert expected_figures(recording(PANOPTIC19), records(0.02, 0.02)).coverage_90 is None
    assert expected_figures(recording(), []) == Expected()


def energy_of(
    on: int, profiles: list[DeviceProfile], battery_wh: float | list[float] = 50.0
) -> Energy:
    """Return the energy of five cameras of which `on` are active."""
    slots = records(0.02, 0.02, on=on)
    drawn = modelled_watts(slots, profiles, "power-saving")
    found = energy_figures(recording(), slots, profiles, "power-saving", battery_wh, drawn)
    assert found is not None
    return found


def test_savings_are_reported_for_both_devices_of_the_paper() -> None:
    found = energy_of(3, [load_profile("generic")] * 5)
    for name, (low, high) in PAPER_SAVINGS.items():
        device = found.devices[name]
        assert low < device.saving_percent < high
        assert device.times_paper == pytest.approx(1.0)
        assert device.aggressive_saving_percent > device.saving_percent
    one = energy_of(1, [load_profile("tx2")] * 5)
    assert one.devices["tx2"].times_paper == pytest.approx(2.0)  # 4 of 5 asleep, not 2


def test_devices_and_batteries_may_differ() -> None:
    profiles = [load_profile(name) for name in ("xavier-nx", "tx2", "tx2", "tx2", "generic")]
    batteries = [10.0, 20.0, 30.0, 40.0, 50.0]
    found = energy_of(5, profiles, batteries)
    assert found.profile == "xavier-nx, tx2, generic"
    assert found.cameras["a"].active_watts == pytest.approx(12.5)
    assert found.cameras["e"].battery_hours == pytest.approx(5.0)
    assert found.cameras["b"].battery_hours == pytest.approx(20 / 12.2)
