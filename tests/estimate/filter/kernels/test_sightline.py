"""A person at a wrong distance from the one camera that follows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.estimate.filter import Model
from e3pose.estimate.filter.kernels.sightline import MOST_M
from e3pose.estimate.filter.kernels.step import StepKernel
from e3pose.estimate.filter.state import Belief
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.simulate import SceneSettings, simulate

Floats = NDArray[np.float64]

SETTLED = 30  # slots in which all cameras show everybody
LONE = 8  # in which one camera does


@pytest.fixture(scope="module")
def followed() -> tuple[Model, Belief, Floats, float]:
    """Return a belief in which one person was seen by one camera alone of late, and the truth."""
    recording = simulate(SceneSettings("ring", people=1, seconds=3.0, fps=12.5), 701)
    assert recording.truth is not None
    model = Model(recording.rig, recording.skeleton, load_noise("simulated"))
    step, belief = StepKernel(), Belief.empty(model)
    truth = recording.truth.joints_m[:, 0]
    slot = 0
    for slot in range(SETTLED + LONE - 1):
        cameras = range(len(recording.rig)) if slot < SETTLED else [0]
        views = {c: exact(model, c, truth[slot]) for c in cameras}
        belief, _ = step(model, belief, views, slot / recording.fps)
    return model, belief, truth[slot + 1], (slot + 1) / recording.fps


def exact(model: Model, camera: int, joints_m: Floats) -> Poses2D:
    """Return a view of one person, without noise."""
    pixels = model.rig.cameras[camera].project(joints_m)
    return Poses2D(pixels[None], np.full((1, len(joints_m)), 0.9))


def moved(model: Model, belief: Belief, metres: float) -> Belief:
    """Return the sure belief that a person is so much farther from the first camera."""
    place = -model.rig.cameras[0].R.T @ model.rig.cameras[0].t
    state = belief.state.copy()
    line = state[..., :3] - place
    state[..., :3] += metres * line / np.linalg.norm(line, axis=-1, keepdims=True)
    sure = replace(belief, covariance=0.1 * belief.covariance, shared=0.1 * belief.shared)
    return replace(sure, state=state)


def error_after(
    followed: tuple[Model, Belief, Floats, float], metres: float, beside_m: float = 0.0
) -> tuple[float, int]:
    """Return the mean error, and how many detections wait, once a second camera showed a person."""
    model, belief, truth, time_s = followed
    seen = exact(model, 2, truth + [0.0, 0.0, beside_m])
    after, _ = StepKernel()(model, moved(model, belief, metres), {2: seen}, time_s)
    error_m = np.linalg.norm(after.state[0, :, :3] - truth, axis=-1).mean()
    return float(error_m), len(after.leftovers.times_s)


@pytest.mark.parametrize("metres", [-0.6, 0.5, 0.7])
def test_wrong_distance_is_put_right_by_the_next_camera(
    followed: tuple[Model, Belief, Floats, float], metres: float
) -> None:
    error_m, waiting = error_after(followed, metres)
    assert error_m < 0.15
    assert waiting == 0


def test_somebody_beside_the_lines_of_sight_is_somebody_else(
    followed: tuple[Model, Belief, Floats, float],
) -> None:
    error_m, waiting = error_after(followed, 0.6, beside_m=0.7)
    assert error_m > 0.4
    assert waiting == 1


def test_nobody_is_moved_through_the_room(
    followed: tuple[Model, Belief, Floats, float],
) -> None:
    error_m, waiting = error_after(followed, 1.5 * MOST_M)
    assert error_m > MOST_M
    assert waiting == 1
