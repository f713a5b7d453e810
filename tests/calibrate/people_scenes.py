"""A small scene of people, and how far one rig is from another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from e3pose.calibrate.moved_cameras import Cameras, placed
from e3pose.model.camera import Rig
from e3pose.model.rotations import angles_between, similarity
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.record import Recording, ViewSeries
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.detections import detect_people
from e3pose.simulate.scenes import SCENES


def walk(
    seed: int, people: int = 1, seconds: float = 20.0, fps: float = 10.0, cameras: int = 4
) -> Recording:
    """Return people before cameras on a ring."""
    settings = SceneSettings(people=people, seconds=seconds, cameras=cameras, fps=fps)
    return simulate(settings, seed=seed)


def standing(seed: int, sway_m: float = 0.03, seconds: float = 30.0, fps: float = 5.0) -> Recording:
    """Return somebody who stands in place and sways before four cameras on a ring."""
    walking = walk(seed, seconds=5.0, fps=fps)
    assert walking.truth is not None
    number, rng = round(seconds * fps), np.random.default_rng(seed)
    phases = 2 * np.pi * np.arange(number)[:, None] / fps / [3.0, 4.0] + rng.uniform(0, 6, 2)
    sway = np.pad(sway_m * np.sin(phases), ((0, 0), (0, 1)))
    joints_m = walking.truth.joints_m[10, 0] + sway[:, None]
    views = tuple(
        detect_people(
            camera, joints_m[:, None], np.zeros(3), SCENES["ring"], 4.2, fps, DetectorSettings(),
            np.random.SeedSequence([seed, number]),
        )
        for number, camera in enumerate(walking.rig.cameras)
    )  # fmt: skip
    return replace(walking, num_slots=number, views=views, truth=None)


def without_calibration(recording: Recording) -> Recording:
    """Return it as detected without a calibration."""
    sizes = {camera.camera_id: camera.image_size for camera in recording.rig.cameras}
    return replace(recording, rig=assumed_rig(sizes), truth=None)


def decentred(recording: Recording, share: float, seed: int) -> Recording:
    """Return it with the axes of all lenses beside the middles of the images."""
    rng = np.random.default_rng(seed)
    cameras, views = [], []
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        aside = rng.normal(0, share * max(camera.image_size), 2)
        K = np.array(camera.K)
        K[:2, 2] += aside
        cameras.append(replace(camera, K=K))
        views.append(replace(series, keypoints_px=series.keypoints_px + aside))
    return replace(recording, rig=Rig(tuple(cameras)), views=tuple(views))


def distances(found: Rig, truth: Rig, with_scale: bool = True) -> tuple[float, float, float]:
    """Return the largest angle in degrees and shift in millimetres, and the scale between rigs."""
    scale, R, t = similarity(found.centers_m, truth.centers_m, with_scale)
    turned = np.stack([camera.R @ R.T for camera in found.cameras])
    angles = angles_between(turned, np.stack([camera.R for camera in truth.cameras]))
    shifts = np.linalg.norm(scale * found.centers_m @ R.T + t - truth.centers_m, axis=1)
    return float(np.degrees(angles).max()), float(1000 * shifts.max()), scale


def disturbed(rig: Rig, degrees: float, metres: float, seed: int) -> Rig:
    """Return a rig with every camera turned and moved by so much, in random directions."""
    rng = np.random.default_rng(seed)
    axes, aside = rng.normal(size=(2, len(rig), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    rotations = (
        Rotation.from_rotvec(np.radians(degrees) * axes).as_matrix() @ Cameras.of(rig).rotations
    )
    centers = rig.centers_m + metres * aside
    translations = -np.einsum("cij,cj->ci", rotations, centers)
    return Cameras(rotations, translations, np.zeros((len(rig), 4))).rig(rig)


def knocked(calm: Recording, index: int, degrees: float, seed: int, from_s: float) -> Recording:
    """Return a recording in which a camera is turned about a random axis from some time on."""
    axis = np.random.default_rng([seed, index]).normal(size=3)
    turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    camera, series = calm.rig.cameras[index], calm.views[index]
    first = int(series.starts[np.searchsorted(series.slots, round(from_s * calm.fps))])
    ideal = camera.normalise(series.keypoints_px[first:])
    rays = np.concatenate([ideal, np.ones_like(ideal[..., :1])], axis=-1) @ turn.T
    pixels = placed(camera, np.eye(3), np.zeros(3)).project(rays)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < camera.image_size)).all(axis=-1)
    seen = inside & (series.scores[first:] > 0)
    pixels = np.concatenate([
        series.keypoints_px[:first], np.where(seen[..., None], pixels, np.nan)
    ])  # fmt: skip
    scores = np.concatenate([series.scores[:first], np.where(seen, series.scores[first:], 0.0)])
    views = list(calm.views)
    views[index] = replace(series, keypoints_px=pixels, scores=scores)
    return replace(calm, views=tuple(views), truth=None)


def every(recording: Recording, step: int, begins: tuple[int, ...]) -> Recording:
    """Return what cameras see that take every `step`-th slot, each from a slot of its own."""
    views = []
    for series, begin in zip(recording.views, begins, strict=True):
        chosen = np.flatnonzero((series.slots >= begin) & ((series.slots - begin) % step == 0))
        rows = [np.arange(series.starts[i], series.starts[i + 1]) for i in chosen.tolist()]
        starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64)
        joined = np.concatenate(rows)
        slots = (series.slots[chosen] - begin) // step
        times = (series.slots[chosen] - begin) / recording.fps
        views.append(
            ViewSeries(slots, times, starts, series.keypoints_px[joined], series.scores[joined])
        )
    last = max(int(view.slots[-1]) for view in views)
    return replace(
        recording, fps=recording.fps / step, num_slots=last + 1, views=tuple(views), truth=None
    )
