"""The compiled step of the filter: its numpy reference, its limits, and what it keeps."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.agreement import (
    ARRAYS,
    KERNEL,
    SIMULATED,
    Slot,
    Slots,
    assert_agree,
    belief_to_arrays,
    follow,
    model,
    ring,
    scene,
    seen,
)
from tests.reference.filter_step import step

from e3pose.base.errors import InputError
from e3pose.base.kernel import INTERPRETING
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.scratch import MAX_LEFTOVERS
from e3pose.estimate.filter.state import MAX_TRACKS
from e3pose.estimate.filter.step import StepKernel, step_slot
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.recording import Recording

pytestmark = pytest.mark.slow

SHARED = os.environ.get("E3POSE_SHARED")
REAL_SLOTS = slice(100, 140)  # with two people and more
# OpenCV's coefficients, and whether of its fisheye model.
LENSES = (
    ((), False),
    ((-0.28, 0.09, 0.0012, -0.0008, -0.01), False),
    ((0.4, 0.06, 0.0012, -0.0008, 0.003, 0.62, 0.11, 0.005), False),
    ((0.02, -0.008, 0.003, -0.0006), True),
)


def through_lenses(recording: Recording, slots: Slots) -> tuple[Model, Slots]:
    """Let the cameras have `LENSES`, and move every keypoint to where its lens puts it."""
    cameras = [
        replace(camera, distortion=np.array(lens), fisheye=fisheye)
        for camera, (lens, fisheye) in zip(recording.rig.cameras, LENSES * 8, strict=False)
    ]

    def moved(index: int, view: Poses2D) -> Poses2D:
        camera = recording.rig.cameras[index]
        places = camera.center_m + camera.rays(view.keypoints_px)
        return Poses2D(cameras[index].project(places), view.scores)

    bent: Slots = [({c: moved(c, view) for c, view in views.items()}, t) for views, t in slots]
    return Model(Rig(tuple(cameras)), recording.skeleton, SIMULATED), bent


def spoilt(slots: Slots, rng: np.random.Generator) -> Iterator[Slot]:
    """Yield slots with everything that may go wrong: ghosts, doubles, swaps, absurd numbers."""
    time_s = 0.0
    for views, _ in slots:
        time_s += float(rng.choice([0.0, -0.02, 0.01, 0.04, 0.04, 0.2, 0.7]))
        time_s += 20.0 if rng.random() < 0.01 else 0.0
        damaged = {}
        for camera, view in views.items():
            keypoints, scores = view.keypoints_px.copy(), view.scores.copy()
            if len(view) and rng.random() < 0.3:  # a ghost, half on somebody
                ghost = keypoints[:1] + rng.normal(scale=rng.choice([3.0, 60.0]), size=(1, 17, 2))
                keypoints = np.concatenate([keypoints, ghost])
                scores = np.concatenate([scores, rng.uniform(0, 1, (1, 17))])
            if rng.random() < 0.1:
                left, right = [5, 7, 9, 11, 13, 15], [6, 8, 10, 12, 14, 16]
                keypoints[:, left + right] = keypoints[:, right + left]
            wild = rng.random(scores.shape)
            keypoints[wild < 0.01] *= 1e7
            keypoints[(wild > 0.01) & (wild < 0.02)] = np.nan
            scores[(wild > 0.02) & (wild < 0.06)] = rng.choice([0.0, 1e-4, 0.04, 0.06, 1.0])
            order = rng.permutation(len(scores))
            damaged[camera] = Poses2D(keypoints[order], scores[order])
        yield damaged, time_s


@each_case(("name", "cameras"), [("ring", 5), ("ring", 1), ("crossing", 2)])
def test_equals_the_reference_over_a_whole_scene(name: str, cameras: int) -> None:
    recording = scene(name)
    people, _ = follow(
        Model(recording.rig, recording.skeleton, SIMULATED), seen(recording, cameras)
    )
    assert people > recording.num_slots  # the comparison is of something


def test_equals_the_reference_with_many_cameras() -> None:
    recording = scene("ring", people=8, cameras=12, seconds=0.6)
    people, _ = follow(Model(recording.rig, recording.skeleton, SIMULATED), seen(recording, 12))
    assert people > 2 * recording.num_slots


def test_equals_the_reference_through_every_kind_of_lens() -> None:
    recording = scene("ring", cameras=8, seconds=1)
    model, slots = through_lenses(recording, seen(recording, 4))
    people, _ = follow(model, slots)
    assert people > recording.num_slots


@each_case("seed", range(2))
def test_equals_the_reference_when_all_goes_wrong(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slots = list(spoilt(seen(ring(), int(rng.integers(1, 6)), seed)[:60], rng))
    _, births = follow(model(), slots)
    assert births > 3


@each_case("bent", [False, True])
def test_interpreted_kernels_do_the_same_when_all_goes_wrong(
    bent: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first start interprets them, and gets no error where compiled ones give none."""
    site, slots = through_lenses(ring(), seen(ring(), 3)) if bent else (model(), seen(ring(), 3))
    slots = list(spoilt(slots[:12], np.random.default_rng(1)))
    compiled, belief = [], Belief.empty(site)
    for views, time_s in slots:
        belief, _ = KERNEL(site, belief, views, time_s)
        compiled.append(belief)
    monkeypatch.setattr(INTERPRETING, "on", True)
    interpreted, belief = StepKernel(), Belief.empty(site)
    with np.errstate(all="ignore"):
        for (views, time_s), wanted in zip(slots, compiled, strict=True):
            belief, _ = interpreted(site, belief, views, time_s)
            assert_agree(belief, wanted)
    assert belief.next_id > 2


@pytest.mark.shared
@pytest.mark.skipif(not SHARED, reason="E3POSE_SHARED is not set")
@pytest.mark.parametrize("cameras", [2, 5])
def test_equals_the_reference_on_a_real_recording(cameras: int) -> None:
    from e3pose_lab.datasets.shelf import import_shelf

    recording = import_shelf(Path(SHARED or "") / "data" / "shelf" / "shelf.npz")
    slots = seen(recording, cameras)[REAL_SLOTS]
    people, _ = follow(Model(recording.rig, recording.skeleton, SIMULATED), slots)
    assert people > 2 * len(slots)


def test_noise_of_a_detector_is_that_of_the_model() -> None:
    sharp = replace(model(), noise=replace(model().noise, sigma_px=model().noise.sigma_px / 3))
    people, _ = follow(sharp, seen(ring(), 2)[:50])
    assert people > 0


@pytest.mark.parametrize("kind", ["body without a head", "joints of unknown names"])
def test_equals_the_reference_with_other_skeletons(kind: str) -> None:
    if kind == "body without a head":
        skeleton = Skeleton("headless", COCO17.joints[5:], ())
    else:
        skeleton = Skeleton("anything", tuple(f"joint{number}" for number in range(12)), ())
    slots: Slots = [
        ({c: Poses2D(v.keypoints_px[:, 5:], v.scores[:, 5:]) for c, v in views.items()}, time_s)
        for views, time_s in seen(ring(), 2)
    ]
    people, _ = follow(Model(ring().rig, skeleton, SIMULATED), slots)
    assert people > 50


@each_case(
    ("views", "time_s", "message"),
    [
        ({9: Poses2D.empty(17)}, 0.0, "camera 9"),
        ({0: Poses2D.empty(14)}, 0.0, "found 14 joints, expected 17"),
        ({}, np.nan, "time: found nan"),
    ],
)
def test_wrong_input_is_the_same_clear_line(
    views: Mapping[int, Poses2D], time_s: float, message: str
) -> None:
    for advance in (step, KERNEL):
        with pytest.raises(InputError, match=message):
            advance(model(), Belief.empty(model()), views, time_s)


def noise(people: int, rng: np.random.Generator) -> Poses2D:
    """Return a view full of detections, each an upright body somewhere in the image."""
    body = rng.uniform((-20, -60), (20, 60), (people, 17, 2))
    spots = rng.uniform((30, 70), (1000, 700), (people, 1, 2))
    return Poses2D(body + spots, rng.uniform(0.2, 1.0, (people, 17)))


def test_views_full_of_noise_are_bounded_and_equal() -> None:
    rng = np.random.default_rng(1)
    plain = fast = Belief.empty(model())
    for slot in range(2):
        views = {camera: noise(3000, rng) for camera in range(5)}
        plain, _ = step(model(), plain, views, slot / 25)
        start = time.thread_time()
        fast, _ = KERNEL(model(), fast, views, slot / 25)
        # Tens of milliseconds; without bounds the pairs alone would take minutes.
        assert time.thread_time() - start < 1.0
        assert_agree(fast, plain)
    assert len(fast) <= MAX_TRACKS
    assert len(fast.leftovers) <= MAX_LEFTOVERS


def test_one_noisy_view_keeps_nobody_from_being_born() -> None:
    rng = np.random.default_rng(2)
    plain = fast = Belief.empty(model())
    for views, time_s in seen(ring(), 5)[:20]:
        crowded = {**views, 0: noise(80, rng)}
        plain, _ = step(model(), plain, crowded, time_s)
        fast, found = KERNEL(model(), fast, crowded, time_s)
        assert_agree(fast, plain)
    assert len(found) >= 3


def test_more_tracks_than_anybody_starts_are_still_stepped() -> None:
    views, _ = seen(ring(), 5)[0]
    belief, _ = step(model(), Belief.empty(model()), views, 0.0)
    copies = 200
    columns = {
        name: np.repeat(column[:1], copies, axis=0) for name, column in belief.columns().items()
    }
    columns["track_ids"] = np.arange(copies)
    state = np.array(columns["state"], dtype=np.float64)
    state[..., 0] += 0.5 * np.arange(copies)[:, None]
    columns["state"] = state
    many = replace(belief, next_id=copies, **columns)  # type: ignore[arg-type]
    expected, _ = step(model(), many, views, 0.04)
    found, _ = KERNEL(model(), many, views, 0.04)
    assert_agree(found, expected)
    assert len(found) > MAX_TRACKS


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
    for number in range(30):
        for index, each in enumerate(models):
            beliefs[index], _ = KERNEL(each, beliefs[index], *slots[index][number])
    for index, each in enumerate(models):
        alone, kernel = Belief.empty(each), StepKernel()
        for slot in slots[index][:30]:
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


def test_a_slot_that_fails_half_way_can_be_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
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
