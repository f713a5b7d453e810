"""What one camera alone tells of how far away a person is."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Model
from e3pose.estimate.filter.lone_view import SIZE_SHARE
from e3pose.estimate.filter.state import Belief
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.simulate import SceneSettings, simulate

Cameras = Callable[[int], tuple[int, ...]]

FPS = 12.5
SETTLED = 25  # slots in which all cameras show a person who stands
AFTER = 25
LARGER = 1.03  # what a lone camera takes the person for

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def room() -> tuple[Model, Floats]:
    """Return the model of a ring of cameras, and where the joints of somebody are."""
    recording = simulate(SceneSettings("ring", people=1, seconds=1.0, fps=FPS), 701)
    assert recording.truth is not None
    model = Model(recording.rig, recording.skeleton, load_noise("simulated"))
    return model, recording.truth.joints_m[0, 0]


def seen(model: Model, camera: int, joints_m: Floats) -> Poses2D:
    """Return a view of one person, without noise."""
    pixels = model.rig.cameras[camera].project(joints_m)
    return Poses2D(pixels[None], np.full((1, len(joints_m)), 0.9))


def run(room: tuple[Model, Floats], cameras: Cameras, times: float = 1.0) -> Belief:
    """Return the belief after some slots of the `cameras(slot)`, who show the person so large."""
    model, joints_m = room
    larger = joints_m.mean(axis=0) + times * (joints_m - joints_m.mean(axis=0))
    step, belief = StepKernel(), Belief.empty(model)
    for slot in range(SETTLED + AFTER):
        views: Mapping[int, Poses2D]
        if slot < SETTLED:
            views = {c: seen(model, c, joints_m) for c in range(len(model.rig))}
        else:
            views = {c: seen(model, c, larger) for c in cameras(slot - SETTLED)}
        belief, _ = step(model, belief, views, slot / FPS)
    return belief


def spreads_m(room: tuple[Model, Floats], belief: Belief) -> tuple[float, float, float]:
    """Return the standard deviation of the hips along and across the first camera's line of sight.

    And how far away they are.
    """
    model, _ = room
    root = model.tree.order[0]
    away = belief.state[0, root, :3] - model.rig.centers_m[0]
    far_m = float(np.linalg.norm(away))
    block = belief.covariance[0, root, :3, :3]
    along = away @ block @ away / far_m**2
    return float(np.sqrt(along)), float(np.sqrt((np.trace(block) - along) / 2)), far_m


def test_many_looks_of_one_camera_tell_the_distance_no_better_than_the_size(
    room: tuple[Model, Floats],
) -> None:
    along_m, across_m, far_m = spreads_m(room, run(room, lambda slot: (0,)))
    assert along_m > 0.7 * SIZE_SHARE * far_m
    assert across_m < 0.3 * along_m


@pytest.mark.parametrize(
    "cameras", [lambda slot: (0, 2), lambda slot: (2 * (slot % 2),)], ids=["both", "in turn"]
)
def test_two_cameras_tell_the_distance_without_it(
    room: tuple[Model, Floats], cameras: Cameras
) -> None:
    along_m, _, _ = spreads_m(room, run(room, cameras))
    assert along_m < 0.04


def test_somebody_who_looks_larger_to_one_camera_comes_nearer_only_until_another_looks(
    room: tuple[Model, Floats],
) -> None:
    model, joints_m = room
    belief = run(room, lambda slot: (0,), LARGER)
    before_m = np.linalg.norm((belief.state[0, :, :3] - joints_m).mean(axis=0))
    far_m = np.linalg.norm(joints_m.mean(axis=0) - model.rig.centers_m[0])
    stated_m, _, _ = spreads_m(room, belief)
    assert before_m < (LARGER - 1) * far_m
    assert before_m < 2 * stated_m
    view = {2: seen(model, 2, joints_m)}
    after, _ = StepKernel()(model, belief, view, belief.time_s + 1 / FPS)
    assert len(after.leftovers.times_s) == 0  # it knows the person again
    after_m = np.linalg.norm((after.state[0, :, :3] - joints_m).mean(axis=0))
    assert after_m < before_m / 2
