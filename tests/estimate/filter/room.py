"""A room with five cameras around people who stand or walk, with truth known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from tests.rigs import on_circle, towards

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.camera import Rig
from e3pose.model.noises import load_noise
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

SIMULATED = load_noise("simulated")

Views = Mapping[int, Poses2D]
step = StepKernel()

NUM_CAMERAS = 5


# A standing person, facing +x: x, y, z of the 17 joints in metres.
BODY = np.array(
    [
        [0.12, 0, 1.62], [0.1, 0.03, 1.65], [0.1, -0.03, 1.65], [0, 0.08, 1.62], [0, -0.08, 1.62],
        [0, 0.2, 1.42], [0, -0.2, 1.42], [0.02, 0.25, 1.12], [0.02, -0.25, 1.12],
        [0.1, 0.25, 0.88], [0.1, -0.25, 0.88], [0, 0.12, 0.92], [0, -0.12, 0.92],
        [0.03, 0.12, 0.5], [0.03, -0.12, 0.5], [0, 0.12, 0.08], [0, -0.12, 0.08],
    ]
)  # fmt: skip


def ring(distortion: tuple[float, ...] = ()) -> Rig:
    angles = np.linspace(0, 2 * np.pi, NUM_CAMERAS, endpoint=False)
    return Rig(tuple(
        towards(f"cam{n}", on_circle(5.0, 2.2, angle), (0, 0, 0.9), (1032, 776), lens=distortion)
        for n, angle in enumerate(angles)
    ))  # fmt: skip


RIG = ring()

MODEL = Model(RIG, COCO17, SIMULATED)

ALL = tuple(range(NUM_CAMERAS))


def standing(*places: tuple[float, float]) -> Floats:
    """Return people `(num_persons, 17, 3)` standing at these places."""
    return np.array([BODY + [x, y, 0] for x, y in places]).reshape(-1, 17, 3)


def see(
    people: Floats,
    cameras: Iterable[int] = ALL,
    noise_px: float = 0.0,
    rng: np.random.Generator | None = None,
    rig: Rig = RIG,
    score: float = 0.9,
) -> dict[int, Poses2D]:
    """Return what the cameras see of people."""
    views = {}
    for camera in cameras:
        pixels = rig.cameras[camera].project(people)
        if rng is not None:
            pixels = pixels + rng.normal(scale=noise_px, size=pixels.shape)
        views[camera] = Poses2D(pixels, np.full(pixels.shape[:2], score))
    return views


def run(
    slots: Iterable[Views], fps: float = 25.0, model: Model = MODEL, belief: Belief | None = None
) -> tuple[Belief, list[People]]:
    belief = Belief.empty(model) if belief is None else belief
    start = 0.0 if np.isnan(belief.time_s) else belief.time_s + 1 / fps
    estimates = []
    for slot, views in enumerate(slots):
        belief, estimate = step(model, belief, views, start + slot / fps)
        estimates.append(estimate)
    return belief, estimates


def error_m(estimate: People, people: Floats) -> Floats:
    """Return `(num_estimated, num_people)` mean joint distances."""
    return np.asarray(
        np.linalg.norm(estimate.joints_m[:, None] - people[None], axis=-1).mean(axis=-1)
    )


def spread_m(estimate: People) -> float:
    return float(np.sqrt(np.trace(estimate.covariance_m2[0], axis1=1, axis2=2)).mean())


def turn(slot: int) -> tuple[int]:
    return (slot * 2 % NUM_CAMERAS,)
