"""The compiled step of the filter against its numpy reference, slot after slot."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.agreement import (
    KERNEL,
    SIMULATED,
    Slot,
    Slots,
    assert_agree,
    follow,
    model,
    ring,
    scene,
    seen,
)
from tests.reference.filter_step import step

from e3pose.base.kernel import INTERPRETING
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.recording import Recording

pytestmark = pytest.mark.slow

SHARED = os.environ.get("E3POSE_SHARED")
REAL_SLOTS = slice(100, 200)  # with two people and more
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


@each_case(
    ("name", "cameras"),
    [("ring", 5), ("ring", 1), ("crossing", 2), ("pillar", 3), ("one-sided", 2)],
)
def test_equals_the_reference_over_a_whole_scene(name: str, cameras: int) -> None:
    recording = scene(name)
    people, _ = follow(
        Model(recording.rig, recording.skeleton, SIMULATED), seen(recording, cameras)
    )
    assert people > recording.num_slots  # the comparison is of something


def test_equals_the_reference_with_many_cameras() -> None:
    recording = scene("ring", people=8, cameras=12, seconds=1)
    people, _ = follow(Model(recording.rig, recording.skeleton, SIMULATED), seen(recording, 12))
    assert people > 2 * recording.num_slots


def test_equals_the_reference_through_every_kind_of_lens() -> None:
    recording = scene("ring", cameras=8, seconds=1)
    model, slots = through_lenses(recording, seen(recording, 4))
    people, _ = follow(model, slots)
    assert people > recording.num_slots


@each_case("seed", range(4))
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
    slots = list(spoilt(slots[:24], np.random.default_rng(1)))
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


def test_backends_may_take_turns() -> None:
    slots = seen(ring(), 2)
    plain = turns = Belief.empty(model())
    for slot, (views, time_s) in enumerate(slots):
        plain, _ = step(model(), plain, views, time_s)
        advance = step if slot // 7 % 2 else KERNEL
        turns, _ = advance(model(), turns, views, time_s)
    assert_agree(turns, plain)
    assert len(turns) >= 3


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


def test_single_camera_rig_never_starts_anybody() -> None:
    camera: Camera = ring().rig.cameras[0]
    model = Model(Rig((camera,)), ring().skeleton, SIMULATED)
    slots = [({c: v for c, v in views.items() if c == 0}, t) for views, t in seen(ring(), 5)]
    assert follow(model, slots[:30]) == (0, 1)  # the next number is 1
