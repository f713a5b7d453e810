"""What a compiled step keeps from slot to slot, and what it leaves as it was."""

from __future__ import annotations

import io
import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.agreement import (
    ARRAYS,
    KERNEL,
    SIMULATED,
    assert_agree,
    model,
    ring,
    scene,
    seen,
)
from tests.reference.belief_arrays import belief_from_arrays, belief_to_arrays

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.step import StepKernel, step_slot
from e3pose.model.pose import Poses2D

pytestmark = pytest.mark.slow


def test_saved_and_restored_goes_on_exactly() -> None:
    slots = seen(ring(), 2)
    straight = resumed = Belief.empty(model())
    for views, time_s in slots:
        straight, _ = KERNEL(model(), straight, views, time_s)
        file = io.BytesIO()
        np.savez(file, **belief_to_arrays(resumed))  # type: ignore[arg-type]
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            restored = belief_from_arrays(arrays, model())
        resumed, _ = StepKernel()(model(), restored, views, time_s)
    for name, array in belief_to_arrays(straight).items():
        np.testing.assert_array_equal(belief_to_arrays(resumed)[name], array)


def test_results_are_not_overwritten_and_arguments_not_changed() -> None:
    slots = seen(ring(), 3)
    belief = Belief.empty(model())
    kept, before = [], []
    for views, time_s in slots[:30]:
        belief, estimate = KERNEL(model(), belief, views, time_s)
        kept.append((belief, estimate))
        before.append([np.array(a) for a in belief_to_arrays(belief).values()])
        before[-1] += [np.array(getattr(estimate, name)) for name in ARRAYS]
    for (belief, estimate), arrays in zip(kept, before, strict=True):
        now = [*belief_to_arrays(belief).values()]
        now += [getattr(estimate, name) for name in ARRAYS]
        for found, expected in zip(now, arrays, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_views_of_read_only_and_strided_arrays_compile_nothing_new() -> None:
    views, time_s = seen(ring(), 5)[10]
    belief, _ = KERNEL(model(), Belief.empty(model()), views, 0.0)
    expected, _ = KERNEL(model(), belief, views, time_s)
    versions = len(step_slot.compiled.signatures)  # type: ignore[attr-defined]
    strided = {}
    for camera, view in views.items():
        keypoints = np.asfortranarray(view.keypoints_px)
        keypoints.flags.writeable = False
        strided[camera] = Poses2D(keypoints, np.asfortranarray(view.scores))
    frozen = replace(belief, state=np.asfortranarray(belief.state))
    frozen.covariance.flags.writeable = False
    found, _ = KERNEL(model(), frozen, strided, time_s)
    assert_agree(found, expected)
    assert len(step_slot.compiled.signatures) == versions  # type: ignore[attr-defined]


def test_one_kernel_serves_several_models() -> None:
    other = scene("crossing", cameras=3)
    models = (model(), Model(other.rig, other.skeleton, SIMULATED))
    slots = (seen(ring(), 2), seen(other, 2))
    beliefs = [Belief.empty(each) for each in models]
    for number in range(40):
        for index, each in enumerate(models):
            beliefs[index], _ = KERNEL(each, beliefs[index], *slots[index][number])
    for index, each in enumerate(models):
        alone, kernel = Belief.empty(each), StepKernel()
        for slot in slots[index][:40]:
            alone, _ = kernel(each, alone, *slot)
        assert_agree(beliefs[index], alone)


def test_kernels_of_several_threads_do_not_disturb_each_other() -> None:
    slots = seen(ring(), 3)
    results: list[Belief] = []

    def work() -> None:
        belief, kernel = Belief.empty(model()), StepKernel()
        for views, time_s in slots:
            belief, _ = kernel(model(), belief, views, time_s)
        results.append(belief)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    for result in results[1:]:
        for name, array in belief_to_arrays(results[0]).items():
            np.testing.assert_array_equal(belief_to_arrays(result)[name], array)


def test_a_slot_that_fails_half_way_can_be_computed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slots, kernel = seen(ring(), 3), StepKernel()
    belief, _ = kernel(model(), Belief.empty(model()), *slots[0])
    belief, _ = kernel(model(), belief, *slots[1])
    expected, _ = StepKernel()(model(), belief, *slots[2])

    def fail(*_: object) -> None:
        for column in kernel._workspace.tracks:
            column[:] = 0
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr(kernel, "_call", fail)
        with pytest.raises(MemoryError):
            kernel(model(), belief, *slots[2])
    assert_agree(kernel(model(), belief, *slots[2])[0], expected)
