"""How much more, or less, than expected people move, learned from corrections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import MODEL, run, see, standing, step, turn

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.agility import FURTHEST, LASTS_S
from e3pose.estimate.filter.estimator import steer

FPS, SLOTS, LIMBS = 25.0, 150, slice(5, 17)


def swaying(slot: int, reach_m: float) -> Floats:
    """Return a person whose limbs jerk to and fro, a little out of step with the cameras."""
    body = standing((0, 0))
    body[:, LIMBS, 0] += reach_m * np.sign(np.sin(2 * np.pi * slot / 16.0))
    return body


def followed(reach_m: float, noise_px: float, cameras: object = turn) -> Belief:
    """Return what is believed after some seconds with one camera in each slot."""
    rng = np.random.default_rng(3)
    slots = [see(swaying(slot, 0.0), noise_px=noise_px, rng=rng) for slot in range(10)]
    slots += [
        see(swaying(slot, reach_m), cameras(slot), noise_px, rng)  # type: ignore[operator]
        for slot in range(SLOTS)
    ]
    belief, _ = run(slots, fps=FPS)
    assert len(belief) == 1
    return belief


def test_noise_shrinks_for_who_stands_still_and_grows_for_who_jerks() -> None:
    still, jerking = (followed(reach_m, 3.0).agility[0, LIMBS].mean() for reach_m in (0.0, 0.12))
    assert -FURTHEST <= still < -0.3
    assert 0.3 < jerking <= FURTHEST


def test_a_camera_that_only_confirms_itself_teaches_nothing() -> None:
    assert np.abs(followed(0.0, 3.0, lambda slot: (0,)).agility).max() < 0.1


def test_all_cameras_at_once_teach_nothing_and_what_was_learned_fades() -> None:
    belief = followed(0.0, 3.0)
    later, _ = run([see(standing((0, 0)))], fps=FPS, belief=belief)
    again, _ = run([see(standing((0, 0)))] * 10, fps=FPS, belief=later)
    left = np.exp(-10 / FPS / LASTS_S)
    np.testing.assert_allclose(again.agility, left * later.agility, atol=1e-12)


def test_a_correction_is_what_the_newest_look_moved() -> None:
    belief = followed(0.0, 3.0)
    alone, _ = step(MODEL, belief, {}, belief.time_s + 1 / FPS)
    np.testing.assert_array_equal(alone.corrected_m, belief.corrected_m)
    off, _ = step(MODEL, belief, see(standing((0.1, 0.0))), belief.time_s + 1 / FPS)
    assert off.corrected_m[0, :, 0].mean() == pytest.approx(0.1, abs=0.06)


@pytest.mark.parametrize("learned", [-1.0, 0.7])
def test_what_a_predictor_leaves_open_counts_times_the_agility(learned: float) -> None:
    belief = followed(0.0, 3.0)
    taught = replace(belief, agility=np.full_like(belief.agility, learned))
    rows, foreseen_m = np.array([0]), belief.state[..., :3]
    steered = steer(MODEL.tree, taught, rows, foreseen_m, 0.08, 0.5)
    np.testing.assert_allclose(steered.drift_share, 0.5 * np.exp(learned))
