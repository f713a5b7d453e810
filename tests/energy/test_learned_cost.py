"""What an active slot costs, found from stretches whose cost is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.energy.profiles import load_profile
from e3pose.energy.site_energy import LearnedCost, learn, slot_cost, unlearned

pytestmark = pytest.mark.slow

PROFILE = load_profile("generic")  # 10 W active, 5.2 W in power-saving
ACTIVE_W, IDLE_W = 7.3, 3.1  # the device at hand
SLOT_S = 0.04


def fed(
    cost: LearnedCost,
    spans: int,
    *,
    active_w: float = ACTIVE_W,
    idle_w: float = IDLE_W,
    noise_w: float = 0.2,
    duty: tuple[float, float] = (0.2, 0.9),
    broken: float = 0.0,
    seed: int = 0,
) -> LearnedCost:
    """Take in heartbeats of half a second, some of which are far off."""
    rng = np.random.default_rng(seed)
    for _ in range(spans):
        share = rng.uniform(*duty)
        energy_j = 0.5 * (share * active_w + (1 - share) * idle_w + noise_w * rng.normal())
        if rng.random() < broken:
            energy_j *= 8
        cost = learn(cost, energy_j, 0.5 * share, 0.5 * (1 - share))
    return cost


def test_profile_is_what_is_said_before_anything_was_measured() -> None:
    cost = slot_cost(unlearned(PROFILE), SLOT_S)
    assert cost.active_j == pytest.approx(10.0 * SLOT_S)
    assert cost.idle_j == pytest.approx(5.2 * SLOT_S)
    assert not cost.measured
    assert cost.why.startswith("modelled: 0 of 10 measurements")


def test_truth_is_found_within_its_uncertainty() -> None:
    """After five minutes of heartbeats, whatever the profile said."""
    misses = []
    for seed in range(12):
        learned = fed(unlearned(PROFILE), 600, seed=seed)
        cost = slot_cost(learned, SLOT_S)
        assert cost.measured
        assert cost.active_j == pytest.approx(ACTIVE_W * SLOT_S, rel=0.05)
        assert cost.idle_j == pytest.approx(IDLE_W * SLOT_S, rel=0.05)
        off = learned.watts - [ACTIVE_W, IDLE_W]
        misses.append(off / np.sqrt(np.diag(learned.covariance)))
    # As many standard deviations off as a standard deviation means: within a factor of two.
    assert 0.5 < np.sqrt(np.mean(np.square(misses))) < 2.0


def test_joules_and_seconds_give_what_slots_give() -> None:
    """A minute reported in one heartbeat counts the same as in a hundred and twenty."""
    cost = unlearned(PROFILE)
    for share in np.linspace(0.1, 0.9, 60):
        cost = learn(
            cost, 60 * (share * ACTIVE_W + (1 - share) * IDLE_W), 60 * share, 60 - 60 * share
        )
    found = slot_cost(cost, 1.0)
    assert found.active_j == pytest.approx(ACTIVE_W, rel=0.01)
    assert found.idle_j == pytest.approx(IDLE_W, rel=0.01)


def test_a_perfect_meter_is_taken_to_be_a_thousandth_off() -> None:
    cost = fed(unlearned(PROFILE), 4000, noise_w=0.0)
    assert cost.noise**0.5 == pytest.approx(1e-3 * ACTIVE_W, rel=0.01)


def test_broken_measurements_pull_little() -> None:
    clean = slot_cost(fed(unlearned(PROFILE), 400), 1.0)
    broken = slot_cost(fed(unlearned(PROFILE), 400, broken=0.03), 1.0)
    assert broken.active_j == pytest.approx(clean.active_j, rel=0.15)
    mean_w = 0.55 * ACTIVE_W + 0.45 * IDLE_W
    least_squares_pull = 0.03 * 7 * mean_w / mean_w
    assert abs(broken.active_j / clean.active_j - 1) < least_squares_pull / 1.5


@each_case("duty", [(1.0, 1.0), (0.0, 0.0), (0.6, 0.6)])
def test_camera_that_never_changes_stays_modelled(duty: tuple[float, float]) -> None:
    learned = fed(unlearned(PROFILE), 3000, duty=duty)
    cost = slot_cost(learned, SLOT_S)
    assert not cost.measured
    assert "too few measurements" in cost.why
    assert np.isfinite(learned.covariance).all()


@cache
def after_an_hour(noise_w: float) -> LearnedCost:
    return fed(unlearned(PROFILE), 7200, noise_w=noise_w)


@each_case("noise_w", [0.0, 0.2])
@each_case("times", [0.5, 1.12, 2.0])
def test_device_that_changes_is_followed_within_minutes(times: float, noise_w: float) -> None:
    """However well its power before was known."""
    cost = after_an_hour(noise_w)
    active_w, idle_w = times * ACTIVE_W, times * IDLE_W
    cost = fed(cost, 720, active_w=active_w, idle_w=idle_w, noise_w=noise_w, seed=1)
    for _ in range(10):  # six minutes later it is known, and stays so
        found = slot_cost(cost, 1.0)
        assert found.measured
        assert found.active_j == pytest.approx(active_w, rel=0.05)
        assert found.idle_j == pytest.approx(idle_w, rel=0.05)
        cost = fed(cost, 60, active_w=active_w, idle_w=idle_w, noise_w=noise_w, seed=2)


@pytest.mark.parametrize("mode", ["active", "idle"])
def test_days_in_one_mode_leave_the_other_no_less_known_than_its_profile(mode: str) -> None:
    """What is not measured is forgotten up to what a profile knows, and no beat moves it far."""
    rng, truth = np.random.default_rng(2), np.array([ACTIVE_W, IDLE_W])
    cost = fed(unlearned(PROFILE), 600)
    prior_w = np.sqrt(np.diag(cost.prior))
    usual = 1.0 if mode == "active" else 0.0
    for hour in range(72):
        # Now and then a camera does something else for a hundredth of a beat.
        for share in (*[usual] * 30, abs(usual - 0.01)):
            shares = np.array([share, 1 - share])
            span_s = 120.0 if share == usual else 0.5
            energy_j = span_s * (shares @ truth + 0.2 * rng.normal() / np.sqrt(2 * span_s))
            cost = learn(cost, float(energy_j), *(span_s * shares).tolist())
            sigma_w = np.sqrt(np.diag(cost.covariance))
            assert (sigma_w <= prior_w * (1 + 1e-6)).all()
            assert (np.abs(cost.watts - truth) < 3 * sigma_w + 0.02 * truth).all(), hour
    assert not slot_cost(cost, SLOT_S).measured  # it is long ago
    found = slot_cost(fed(cost, 240, seed=4), SLOT_S)  # two minutes of both
    assert found.measured
    assert found.active_j == pytest.approx(ACTIVE_W * SLOT_S, rel=0.05)
    assert found.idle_j == pytest.approx(IDLE_W * SLOT_S, rel=0.05)


@each_case(
    ("energy_j", "active_s", "idle_s"),
    [
        (np.nan, 1.0, 1.0),
        (-1.0, 1.0, 1.0),
        (5.0, -1.0, 2.0),
        (5.0, 0.0, 0.0),
        (5.0, np.inf, 1.0),
        (1e6, 1e6, 0.0),
    ],
)
def test_impossible_stretches_say_nothing(energy_j: float, active_s: float, idle_s: float) -> None:
    cost = fed(unlearned(PROFILE), 20)
    assert learn(cost, energy_j, active_s, idle_s) is cost
