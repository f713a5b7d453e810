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
from e3pose.simulate.activities import GRID_HZ, Life, Play
from e3pose.simulate.body import Body, Posture, draw_body, joints_of
from e3pose.simulate.detections import detect_people, until
from e3pose.simulate.episodes import with_episodes
from e3pose.simulate.gait import Gait, plan_gait, smoothstep
from e3pose.simulate.gestures import RAMP_S, move_arms
from e3pose.simulate.guesses import DECLARED, OUTPUTS
from e3pose.simulate.place import Condition, Scene
from e3pose.simulate.scenes import scene_by_name
from e3pose.simulate.settings import MAX_SLOTS, DetectorSettings, SceneSettings, check_number
from e3pose.simulate.situations import draw_fields

SEAT_HEIGHT_M = 0.45
HIP_OVER_SEAT_M = 0.09
STOPPED, LEAST_M = (5, 6, 7, 8, 9, 10, 13, 14), 0.02  # joints of COCO-17; over the floor
STRAIGHTNESS = 0.988  # share of its full length that a standing leg has
SOFT_M = 0.006  # rounding where the pelvis passes from one leg's reach to the other's
SMOOTH_S = 0.10  # a path is smoothed with a Gaussian of this width


def move(
    body: Body, life: Life, times_s: Floats, slots_s: Floats, rng: np.random.Generator
) -> Floats:
    """Return the joints `(num_slots, 17, 3)` of one person in metres, NaN while away.

    Args:
        body: the person's bones.
        life: what the person does on the grid.
        times_s: `(num_times,)` the grid.
        slots_s: `(num_slots,)` times within the grid at which the body is wanted.
        rng: for small involuntary movements.
    """
    joints = np.full((len(slots_s), 17, 3), np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], life.present.view(np.int8), [0]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start < 2:
            continue
        inside = (slots_s >= times_s[start] - 1e-9) & (slots_s <= times_s[stop - 1] + 1e-9)
        stay = slice(int(start), int(stop))
        joints[inside] = _stay(body, life, stay, times_s[stay], slots_s[inside], rng)
    return joints


def _stay(
    body: Body,
    life: Life,
    stay: slice,
    times_s: Floats,
    slots_s: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return the joints at `slots_s` of one uninterrupted stay in the scene."""
    root = _smooth(life.xy[stay])
    heading = _smooth(np.unwrap(life.heading[stay])[:, None])[:, 0]
    seated = smoothstep(life.seated[stay])
    gait = plan_gait(times_s, root, heading, body.leg, body.ankle_height, bool(rng.uniform() < 0.5))
    speed = np.linalg.norm(np.gradient(root, times_s, axis=0), axis=-1)
    gestures = tuple(g for g in life.gestures if times_s[0] - RAMP_S <= g.start_s <= times_s[-1])
    arms = move_arms(times_s, gait.rhythm, seated, gestures)
    # Slow aimless movements `(num_times, 10)` of about unit size.
    rate = rng.uniform(0.05, 0.45, (6, 10))
    phase = rng.uniform(0, 2 * np.pi, (6, 10))
    waves = [np.sin(2 * np.pi * np.outer(times_s, r) + p) for r, p in zip(rate, phase, strict=True)]
    drift = np.sum(waves, axis=0) / np.sqrt(3.0)
    arms += 0.06 * drift[:, None, :4] * np.array([[1.0], [-0.8]])
    # The torso leans forward most while sitting down or getting up.
    lean = 0.03 + 0.04 * np.minimum(speed, 1.5) + 0.55 * np.sin(np.pi * life.seated[stay]) ** 2
    lean -= 0.1 * seated
    posture = Posture(
        pelvis_m=_pelvis(body, root, heading, seated, gait, drift),
        pelvis=np.stack(
            [heading - 0.09 * gait.rhythm, np.zeros_like(heading), 0.05 * gait.sway], axis=-1
        ),
        torso=np.stack(
            [
                heading + 0.11 * gait.rhythm + 0.05 * drift[:, 4],
                lean + 0.02 * drift[:, 5],
                0.015 * drift[:, 6] - 0.02 * gait.sway,
            ],
            axis=-1,
        ),
        head=np.stack(
            [
                heading + 0.28 * drift[:, 7] * np.exp(-speed),
                0.08 + 0.08 * drift[:, 8],
                0.03 * drift[:, 9],
            ],
            axis=-1,
        ),
        knees=heading,
        ankles_m=gait.ankles_m,
        arms=arms,
    )
    posture = with_episodes(body, posture, times_s, root, heading, tuple(life.episodes))
    joints = joints_of(body, _sampled(posture, times_s, slots_s))
    if life.episodes:  # arms and knees are not posed against the floor: it stops them
        joints[:, STOPPED, 2] = np.maximum(joints[:, STOPPED, 2], LEAST_M)
    return joints


def _pelvis(
    body: Body, root: Floats, heading: Floats, seated: Floats, gait: Gait, drift: Floats
) -> Floats:
    """Return the point between the hips: over the feet, as high as both legs reach."""
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    back = (0.93 * body.thigh - 0.02) * smoothstep(1.15 * seated)
    xy = root + left * (0.022 * gait.sway + 0.012 * drift[:, 0] * (1 - seated))[:, None]
    xy = xy - ahead * (back - 0.01 * drift[:, 1] * (1 - seated))[:, None]
    standing = body.ankle_height + STRAIGHTNESS * body.leg
    heights = [np.full(len(root), standing)]
    for foot, side in enumerate((1.0, -1.0)):
        hip = xy + side * body.hip_half * left
        across = np.linalg.norm(gait.ankles_m[:, foot, :2] - hip, axis=-1)
        reach = np.sqrt(np.maximum((0.996 * body.leg) ** 2 - across**2, 0.01))
        heights.append(gait.ankles_m[:, foot, 2] + reach)
    stacked = np.stack(heights)
    lowest = stacked.min(axis=0)
    height = lowest - SOFT_M * np.log(np.exp(-(stacked - lowest) / SOFT_M).sum(axis=0))
    height = height + (SEAT_HEIGHT_M + HIP_OVER_SEAT_M - height) * seated
    return np.concatenate([xy, np.minimum(_smooth(height[:, None]), lowest[:, None])], axis=-1)


def _smooth(values: Floats) -> Floats:
    """Smooth `(num_times, components)` along time with a Gaussian; ends keep their value."""
    half = int(3 * SMOOTH_S * GRID_HZ)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / (SMOOTH_S * GRID_HZ)) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=-1)


def _sampled(posture: Posture, times_s: Floats, slots_s: Floats) -> Posture:
    """Return the posture at other times, interpolated linearly."""
    upper = np.clip(np.searchsorted(times_s, slots_s), 1, len(times_s) - 1)
    lower = upper - 1
    share = np.clip((slots_s - times_s[lower]) / (times_s[upper] - times_s[lower]), 0.0, 1.0)

    def at(values: Floats) -> Floats:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[lower] * (1 - weight) + values[upper] * weight)

    return Posture(
        at(posture.pelvis_m), at(posture.pelvis), at(posture.torso), at(posture.head),
        at(posture.knees), at(posture.ankles_m), at(posture.arms),
    )  # fmt: skip


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
    """Return the activities of the people of `simulate(settings, seed)`."""
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
    """Return the detector as the condition of a camera worsens it."""
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
