"""Scenes for the compiled step of the filter, and its agreement with the numpy reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache

import numpy as np
from numpy.typing import NDArray
from tests.reference.filter_step import step

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")
AGREE = 1e-6  # metres, seconds and all else; both do the same sums in another order
KERNEL = StepKernel()
ARRAYS = ("track_ids", "joints_m", "scores", "measured", "full_covariance_m2")  # of `People`

Slot = tuple[Mapping[int, Poses2D], float]
Slots = list[Slot]


def belief_to_arrays(belief: Belief) -> dict[str, NDArray[np.generic]]:
    """Return all that a belief holds by name."""
    waiting = belief.leftovers
    return {
        "time_s": np.array(belief.time_s),
        "next_id": np.array(belief.next_id),
        "failed_pairs": belief.failed_pairs,
        "detection_map": belief.detection_map,
        "noise": belief.noise,
        **belief.columns(),
        **{f"leftover_{item.name}": getattr(waiting, item.name) for item in fields(waiting)},
    }


def assert_agree(first: Belief, second: Belief) -> None:
    """Integers, flags and what is missing are equal, numbers within `AGREE`."""
    expected = belief_to_arrays(second)
    for name, found in belief_to_arrays(first).items():
        assert found.shape == expected[name].shape, name
        assert found.dtype == expected[name].dtype, name
        if found.dtype.kind == "f":
            assert np.allclose(found, expected[name], AGREE, AGREE, equal_nan=True), name
        else:
            np.testing.assert_array_equal(found, expected[name], err_msg=name)


def follow(model: Model, slots: Sequence[Slot]) -> tuple[int, int]:
    """Run both over all slots, comparing everything; return how many people and births there were.

    Each has its own belief, so that differences may add up.
    """
    plain = fast = Belief.empty(model)
    people = 0
    for views, time_s in slots:
        plain, expected = step(model, plain, views, time_s)
        fast, found = KERNEL(model, fast, views, time_s)
        assert_agree(fast, plain)
        for name in ARRAYS:
            a, b = getattr(found, name), getattr(expected, name)
            np.testing.assert_allclose(a, b, rtol=AGREE, atol=AGREE, err_msg=name)
        people += len(found)
    return people, fast.next_id


def seen(recording: Recording, cameras: int, seed: int = 0) -> Slots:
    """Return the slots of a recording as so many cameras, drawn anew every time, see them."""
    rng = np.random.default_rng(seed)
    slots: Slots = []
    for slot in range(recording.num_slots):
        chosen = rng.permutation(len(recording.rig))[:cameras].tolist()
        views = {camera: recording.view(slot, camera) for camera in chosen}
        present = {camera: view for camera, view in views.items() if view is not None}
        slots.append((present, slot * recording.interval_s))
    return slots


def scene(name: str, people: int = 4, cameras: int = 5, seconds: float = 1.4) -> Recording:
    return simulate(
        SceneSettings(scene=name, people=people, seconds=seconds, cameras=cameras), seed=5
    )


@cache
def ring() -> Recording:
    return scene("ring")


@cache
def model() -> Model:
    return Model(ring().rig, ring().skeleton, SIMULATED)
