"""Simulate a recording of a scene, with exact truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig, spot_rig, watched_area
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth
from e3pose.simulate.activities import Life, Play
from e3pose.simulate.body import draw_body
from e3pose.simulate.detections import detect_people, until
from e3pose.simulate.guesses import DECLARED, OUTPUTS
from e3pose.simulate.motion import move
from e3pose.simulate.place import Condition, Scene
from e3pose.simulate.scenes import scene_by_name
from e3pose.simulate.settings import MAX_SLOTS, DetectorSettings, SceneSettings, check_number
from e3pose.simulate.situations import draw_fields

ACTIVE_W = 12.5  # of a camera that is always active: the shipped profile of the Xavier NX
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
        InputError: when the scene is unknown, or the settings ask for too much or do not fit it.
    """
    check_number("seed", seed, 0, 2**63 - 1, whole=True)
    report = progress or (lambda share: None)
    scene, number, seeds = _drawn(settings, seed)
    fps = scene.fps if settings.fps is None else settings.fps
    check_number("slots (seconds x fps)", settings.seconds * fps, 1, MAX_SLOTS)
    num_slots = max(1, round(settings.seconds * fps))
    rig_seed, life_seed, body_seed, view_seed, field_seed = seeds
    stage = _place(settings, scene, np.random.default_rng(rig_seed))
    settings.check_size(num_slots, len(stage.rig), number)
    joints = _lives(
        stage.scene,
        number,
        settings.seconds,
        np.arange(num_slots) / fps,
        life_seed,
        body_seed,
        lambda share: report(LIVES_SHARE * share),
    )
    offset = np.array([*stage.centre, 0.0])
    detector = scene.detector if settings.detector is None else settings.detector
    fields = draw_fields(np.random.default_rng(field_seed), number, OUTPUTS)
    views = []
    cameras = zip(stage.rig.cameras, stage.focus_m, view_seed.spawn(len(stage.rig)), strict=True)
    for index, (camera, focus_m, child) in enumerate(cameras):
        condition = stage.scene.conditions.get(index, Condition())
        series = detect_people(
            camera, joints, offset, stage.scene, float(focus_m), fps,
            _worsened(detector, condition), child, fields,
        )  # fmt: skip
        if condition.dies_at is not None:
            series = until(series, condition.dies_at * num_slots)
        views.append(series)
        report(LIVES_SHARE + (1 - LIVES_SHARE) * len(views) / len(stage.rig))
    exact = ", exact detections" if detector.perfect else ""
    return Recording(
        name=f"simulated {settings.scene}, {plural(number, 'person', 'people')}, seed {seed}",
        rig=stage.rig,
        fps=fps,
        num_slots=num_slots,
        skeleton=COCO17,
        views=tuple(views),
        truth=Truth(COCO17, tuple(f"person{i + 1}" for i in range(number)), joints + offset),
        truth_complete=True,
        battery_wh=_batteries(stage, num_slots / fps),
        dies_at_s={
            camera_id: condition.dies_at * num_slots / fps
            for camera_id, condition in _conditions(stage)
            if condition.dies_at is not None
        },
        detector=DECLARED if detector.guessing and not detector.perfect else "simulated",
        source=f"simulated by e3pose: scene {settings.scene}, seed {seed}{exact}; free of rights",
    )


def lives_of(settings: SceneSettings, seed: int = 0) -> tuple[Life, ...]:
    """Return what each of the people of `simulate(settings, seed)` does."""
    scene, number, (rig_seed, life_seed, *_) = _drawn(settings, seed)
    stage = _place(settings, scene, np.random.default_rng(rig_seed))
    play = Play(stage.scene, number, np.random.default_rng(life_seed))
    _, lives = play.run(settings.seconds + AFTER_S, lambda share: None)
    return tuple(lives)


def _drawn(settings: SceneSettings, seed: int) -> tuple[Scene, int, list[np.random.SeedSequence]]:
    """Return the scene, how many people take part, and seeds: rig, lives, bodies, views, fields."""
    scene = scene_by_name(settings.scene)
    number = scene.people if settings.people is None else int(settings.people)
    return scene, number, np.random.SeedSequence(int(seed)).spawn(5)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """A scene with its cameras: where its origin lies on the floor, and how lenses are focused."""

    rig: Rig
    scene: Scene
    centre: Floats
    focus_m: Floats


def _place(settings: SceneSettings, scene: Scene, rng: np.random.Generator) -> _Stage:
    """Fit scene and rig to each other."""
    if settings.rig is not None:
        if scene.rooms or scene.spots:
            raise InputError(
                f"simulate: scene: found {settings.scene} beside a rig of its own, expected one "
                "without rooms and tables: they would stand anywhere among those cameras"
            )
        centre, area_m = watched_area(settings.rig)
        return _Stage(settings.rig, scene.fitted(area_m), centre, _focus(settings.rig, centre))
    if scene.spots:
        return _Stage(*_own_cameras(settings, scene, rng))
    radius = scene.radius_m if settings.radius_m is None else settings.radius_m
    height = scene.height_m if settings.height_m is None else settings.height_m
    number = scene.cameras if settings.cameras is None else int(settings.cameras)
    rig = ring_rig(number, radius, height, settings.image_size, rng)
    if settings.radius_m is not None:
        scene = scene.fitted(scene.area_m * radius / scene.radius_m)
    return _Stage(rig, scene, np.zeros(2), _focus(rig, np.zeros(2)))


def _own_cameras(
    settings: SceneSettings, scene: Scene, rng: np.random.Generator
) -> tuple[Rig, Scene, Floats, Floats]:
    for name, value in (("radius", settings.radius_m), ("height", settings.height_m)):
        if value is not None:
            raise InputError(
                f"simulate: {name}: found {value:g}, expected none: scene {settings.scene} has "
                "cameras of its own"
            )
    number = len(scene.spots) if settings.cameras is None else int(settings.cameras)
    check_number("cameras", number, 1, len(scene.spots), whole=True)
    rig, focus_m = spot_rig(scene.spots[:number], settings.image_size, rng)
    return rig, scene, np.zeros(2), focus_m


def _focus(rig: Rig, centre: Floats) -> Floats:
    """Return `(num_cameras,)` metres over the floor to the middle of the scene, 1 at the least."""
    return np.asarray(np.maximum(np.hypot(*(rig.centers_m[:, :2] - centre).T), 1.0))


def _worsened(detector: DetectorSettings, condition: Condition) -> DetectorSettings:
    """Return what a camera in this condition makes of the detector."""
    guessing = detector.guessing and replace(
        detector.guessing,
        joint_miss=min(detector.guessing.joint_miss + condition.joint_miss, 1.0),
        person_miss=min(detector.guessing.person_miss + condition.person_miss, 1.0),
    )
    return replace(
        detector,
        guessing=guessing,
        noise=min(detector.noise * condition.noise, 100.0),
        blur=detector.blur + condition.blur,
        joint_miss=min(detector.joint_miss + condition.joint_miss, 1.0),
        person_miss=min(detector.person_miss + condition.person_miss, 1.0),
    )


def _conditions(stage: _Stage) -> list[tuple[str, Condition]]:
    """List the cameras about which something is special."""
    ids = stage.rig.camera_ids
    return [(ids[i], condition) for i, condition in stage.scene.conditions.items() if i < len(ids)]


def _batteries(stage: _Stage, seconds: float) -> dict[str, float]:
    """Return watt-hours by camera, for as long a share of the recording as its condition says."""
    always_wh = ACTIVE_W * seconds / 3600
    return {
        camera_id: condition.battery * always_wh
        for camera_id, condition in _conditions(stage)
        if condition.battery is not None
    }


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
        body = draw_body(rng, scene.statures_m)
        joints[:, person] = move(body, life, times_s, slots_s, rng)
        if scene.platforms:
            under = joints[:, person, 11:13, :2].mean(axis=1)
            joints[:, person, :, 2] += scene.floor_m(under)[:, None]
    return joints
