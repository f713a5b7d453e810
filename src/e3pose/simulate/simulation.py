"""Make a recording of a simulated scene, with its exact truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig
from e3pose.recording import Recording, Truth
from e3pose.simulate.body import draw_body
from e3pose.simulate.detections import detect_people
from e3pose.simulate.lives import Play
from e3pose.simulate.motion import move
from e3pose.simulate.rigs import ring_rig, watched_area
from e3pose.simulate.scenes import Scene, scene_by_name
from e3pose.simulate.settings import SceneSettings, check_number
from e3pose.skeleton import COCO17

Floats = NDArray[np.float64]

LIVES_SHARE = 0.15  # of the work, for the progress bar
AFTER_S = 1.0  # life goes on for so long after the last slot


def simulate(
    settings: SceneSettings, seed: int = 0, progress: Callable[[float], None] | None = None
) -> Recording:
    """Simulate people in a scene, and what the detectors of a rig make of them.

    The same settings and seed always give the same recording. What people do depends on the seed,
    the scene, their number and the length alone: other cameras, detectors or frame rates see the
    same lives.

    Args:
        settings: scene, people, cameras, detectors.
        seed: 0 or larger.
        progress: called with the share of the work that is done, from 0 to 1.

    Returns:
        A recording in COCO-17 with complete truth; people who are away have NaN joints.

    Raises:
        InputError: when the scene is unknown, or the settings ask for too much.
    """
    check_number("seed", seed, 0, 2**63 - 1, whole=True)
    report = progress or (lambda share: None)
    scene = scene_by_name(settings.scene)
    number = scene.people if settings.people is None else int(settings.people)
    rig_seed, life_seed, body_seed, view_seed = np.random.SeedSequence(int(seed)).spawn(4)
    rig, scene, centre = _place(settings, scene, np.random.default_rng(rig_seed))
    settings.check_size(len(rig), number)
    slots_s = np.arange(settings.num_slots) / settings.fps
    joints = _lives(
        scene,
        number,
        settings.seconds,
        slots_s,
        life_seed,
        body_seed,
        lambda share: report(LIVES_SHARE * share),
    )
    offset = np.array([*centre, 0.0])
    views = []
    for camera, child in zip(rig.cameras, view_seed.spawn(len(rig)), strict=True):
        views.append(
            detect_people(
                camera, joints, offset, scene.occluders, scene.area_m, settings.fps,
                settings.detector, child,
            )
        )  # fmt: skip
        report(LIVES_SHARE + (1 - LIVES_SHARE) * len(views) / len(rig))
    exact = ", exact detections" if settings.detector.perfect else ""
    return Recording(
        name=f"simulated {settings.scene}, {number} people, seed {seed}",
        rig=rig,
        fps=settings.fps,
        num_slots=settings.num_slots,
        skeleton=COCO17,
        views=tuple(views),
        truth=Truth(COCO17, tuple(f"person{i + 1}" for i in range(number)), joints + offset),
        truth_complete=True,
        source=f"simulated by e3pose: scene {settings.scene}, seed {seed}{exact}; free of rights",
    )


def _place(
    settings: SceneSettings, scene: Scene, rng: np.random.Generator
) -> tuple[Rig, Scene, Floats]:
    """Return the rig, the scene fitted to it, and where on the floor the scene's origin is."""
    if settings.rig is not None:
        centre, area_m = watched_area(settings.rig)
        return settings.rig, scene.fitted(area_m), centre
    radius = scene.radius_m if settings.radius_m is None else settings.radius_m
    height = scene.height_m if settings.height_m is None else settings.height_m
    rig = ring_rig(int(settings.cameras), radius, height, settings.image_size, rng)
    if settings.radius_m is not None:
        scene = scene.fitted(scene.area_m * radius / scene.radius_m)
    return rig, scene, np.zeros(2)


def _lives(
    scene: Scene,
    number: int,
    seconds: float,
    slots_s: Floats,
    life_seed: np.random.SeedSequence,
    body_seed: np.random.SeedSequence,
    progress: Callable[[float], None],
) -> Floats:
    """Return everybody's joints `(num_slots, num_persons, 17, 3)` in the scene."""
    times_s, lives = Play(scene, number, np.random.default_rng(life_seed)).run(
        seconds + AFTER_S, progress
    )
    joints = np.full((len(slots_s), number, 17, 3), np.nan)
    for person, (life, child) in enumerate(zip(lives, body_seed.spawn(number), strict=True)):
        rng = np.random.default_rng(child)
        body = draw_body(rng)
        joints[:, person] = move(body, life, times_s, slots_s, rng)
    return joints
