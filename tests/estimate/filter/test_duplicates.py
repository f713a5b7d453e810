"""Two tracks of one person become one; two people who are close stay two."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from tests.reference.filter_step import step

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.estimator import FilterStep
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

SIMULATED = load_noise("simulated")

SPREAD = 1.5


@cache
def scene() -> Recording:
    return simulate(SceneSettings("ring", people=1, seconds=4, cameras=4, fps=25), seed=3)


@cache
def model() -> Model:
    return Model(scene().rig, scene().skeleton, SIMULATED)


def people_shown(
    advance: FilterStep,
    rows_of: Callable[[int], list[int]],
    other_of: Callable[[Floats], Floats],
) -> list[int]:
    """Return how many people are shown in each slot.

    Somebody walks, and there is what may be somebody else: a view shows the rows of the two that
    `rows_of` its camera gives.
    """
    truth = scene().truth
    assert truth is not None and truth.skeleton == scene().skeleton
    rng, belief, numbers = np.random.default_rng(1), Belief.empty(model()), []
    for slot in range(scene().num_slots):
        person = wide(truth.joints_m[slot, 0])
        views = {}
        for index, camera in enumerate(scene().rig.cameras):
            pair = camera.project(np.stack([person, other_of(person)]))
            pair += rng.normal(scale=3.0, size=pair.shape)
            rows = rows_of(index)
            views[index] = Poses2D(pair[rows], np.full(pair[rows].shape[:2], 0.8))
        belief, estimate = advance(model(), belief, views, slot / scene().fps)
        numbers.append(len(estimate))
    return numbers


def wide(person: Floats) -> Floats:
    """Return somebody whose arms and legs are spread."""
    middle = person.mean(axis=0)
    return np.asarray(middle + (person - middle) * [SPREAD, SPREAD, 1.0])


def mirrored(person: Floats) -> Floats:
    """Return the joints of somebody of whom a detector takes the front for the back."""
    swap = {"left": "right", "right": "left"}
    names = [name.split("_", 1) for name in scene().skeleton.joints]
    others = ["_".join([swap.get(name[0], name[0]), *name[1:]]) for name in names]
    return np.asarray(person[[scene().skeleton.index(name) for name in others]])


@pytest.mark.parametrize("advance", [step, StepKernel()])
def test_cameras_that_take_front_for_back_show_one_person(advance: FilterStep) -> None:
    numbers = people_shown(advance, lambda camera: [int(camera in (0, 1))], mirrored)
    assert max(numbers) >= 1
    assert numbers[-50:] == [1] * 50


@pytest.mark.parametrize("advance", [step, StepKernel()])
def test_people_arm_in_arm_stay_two(advance: FilterStep) -> None:
    rng = np.random.default_rng(2)  # often one hides the other, and the view shows one of them
    rows = [[0, 1], [0, 1], [0], [1], [1]]
    numbers = people_shown(
        advance, lambda camera: rows[rng.integers(5)], lambda person: person + [0.31, 0.0, 0.0]
    )
    assert numbers[-50:] == [2] * 50
