"""Episodes: falls have the kinematics of filmed ones, bodies stay whole, truth is told."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case
from tests.events.bodies import FPS, doing

from e3pose.base.errors import InputError
from e3pose.simulate.episodes import EPISODES, FALLS, plan_episode
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import lives_of, simulate


def test_falls_are_as_fast_as_filmed_ones() -> None:
    """2.14 m/s (0.63) of the pelvis at impact (Choi et al. 2015)."""
    fastest = []
    for kind in ("fall-forward", "fall-backward", "fall-left", "fall-right"):
        for seed in range(10):
            height_m = doing(kind, seed)[:, 11:13, 2].mean(axis=1)
            fastest.append(-np.gradient(height_m, 1 / FPS).min())
    assert 1.5 < np.mean(fastest) < 2.8


@each_case("kind", EPISODES)
def test_a_body_stays_whole_and_over_the_floor(kind: str) -> None:
    joints_m = doing(kind, 3)
    thigh_m = np.linalg.norm(joints_m[:, 11] - joints_m[:, 13], axis=-1)
    assert np.ptp(thigh_m) < 0.25  # the floor stops knees
    assert joints_m[..., 2].min() > -0.08
    assert np.abs(np.diff(joints_m[:, 11:13], axis=0)).max() < 0.5


def test_what_happens_in_a_home_is_known() -> None:
    made = SceneSettings(scene="home-fall", seconds=40, fps=5.0)
    (life,) = lives_of(made, 1)
    first = life.episodes[0]
    assert first.kind in FALLS
    recording = simulate(made, 1)
    assert recording.truth is not None
    hips_m = recording.truth.joints_m[:, 0, 11:13, 2].mean(axis=1)
    at = int((first.down_s + 1.5) * 5)
    assert hips_m[at] < 0.35 < hips_m[int(first.start_s * 5) - 1]


def test_unknown_episode_names_those_that_are_known() -> None:
    with pytest.raises(InputError, match=r"'fly'.*fall-forward"):
        plan_episode("fly", 0.0, np.random.default_rng(0))
