"""Errors of simulated detectors beside those of real ones, from detections alone.

    python lab/benchmarks/detector_errors.py --scenes buffet,round-table,ring-
    python lab/benchmarks/detector_errors.py --recording clip=FOLDER --scenes buffet --seed 901

A scene with `+` has errors by situation, one with `-` errors by score alone; without either, its
own. In one with `~` those of the first camera last for seconds and look consistent; with `^` that
camera gives all of them a score of 0.99 besides. Real ones are those of `E3POSE_SHARED`.

Everybody's path is smoothed over all views but one and compared with that one (as `e3pose calibrate
noise` does it): no label and no truth is looked at. Who hides a joint is judged on the paths, too,
so that a real recording and a simulated one go through the same hands.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.model.noise import IMAGE_PX, LEAST_SCORE
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, convert
from e3pose.recording import Recording, ViewSeries, load_recording
from e3pose.simulate.hidden_joints import covered_by_others, covered_by_self
from e3pose.simulate.noise import correlated
from e3pose_lab.noise.calibrate import all_camera_tracks
from e3pose_lab.noise.residuals import (
    SUPPORT_S,
    SUPPORT_VIEWS,
    Observed,
    assign_detections,
    leave_one_out,
)

SECONDS, FPS, SEED = 12.0, 25.0, 901
SCENES = "ring-,meeting-,ring+,buffet,round-table,reception,lab,operating-room"
CLEAR, SQUARE = 0.1, 0.9  # of a cover: below nothing hides a joint, above something does
PARTS = {
    "face": range(5), "shoulders": (5, 6), "elbows": (7, 8), "wrists": (9, 10), "hips": (11, 12),
    "knees": (13, 14), "ankles": (15, 16),
}  # fmt: skip
GROUPS: dict[str, Callable[[Keypoints], Flags]] = {
    "clear": lambda k: (k.others < CLEAR) & (k.own < CLEAR) & ~k.boxed,
    "behind the own body": lambda k: (k.others < CLEAR) & (k.own > SQUARE),
    "behind another": lambda k: k.others > SQUARE,
    "in the box of one nearer": lambda k: k.boxed & (k.others < CLEAR),
}
LEAST = 100  # keypoints of a figure
BENT_PX, BENT_S, SURE_SCORE = 4.0, 4.0, 0.99  # of the camera whose errors last


LAGS_S = (0.04, 0.2, 1.0, 5.0)
WINSOR_CM = 15.0  # one wild moment does not decide a mean or a correlation
GROSS_PX, GROSS_CM = 30.0, 15.0
SECTORS = 8  # directions of view around a body
MIRRORED = [0, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15]


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """Keypoints that two other views confirm, one row each.

    Attributes:
        error_px: `(num, 2)` keypoint minus reference, right and down, of an image of `IMAGE_PX`.
        error_cm: `(num, 2)` the same at the person's distance.
        score: `(num,)`.
        joint: `(num,)` of COCO-17.
        camera: `(num,)`.
        series: `(num,)` one number per person, camera and joint.
        slot: `(num,)`.
        sector: `(num,)` from where the person is seen: 0 is from ahead, 2 from the person's left.
        others: `(num,)` how squarely another body covers the joint, 0 to 1.
        own: `(num,)` the same of the person's own body.
        boxed: `(num,)` whether the box of somebody nearer contains the joint.
        seen: `(num,)` whether the camera detected it; without, errors are NaN and the score 0.
        met: `(num,)` whether the camera detected anything of the person.
        mirror_cm: `(num,)` how far the keypoint is off the joint of the other side.
        front_cm: `(num,)` how far it is off the same joint of the nearest person before this one
            in the image, inf without anybody.
        speed_mps: `(num,)` of the person's hips.
    """

    error_px: Floats
    error_cm: Floats
    score: Floats
    joint: Integers
    camera: Integers
    series: Integers
    slot: Integers
    sector: Integers
    others: Floats
    own: Floats
    boxed: Flags
    seen: Flags
    met: Flags
    mirror_cm: Floats
    front_cm: Floats
    speed_mps: Floats

    def only(self, rows: Flags) -> Keypoints:
        """Return some of them."""
        return Keypoints(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def gather(recording: Recording, first: int = 0, num_slots: int | None = None) -> Keypoints:
    """Compare every view of a recording with all others.

    Args:
        recording: its truth is not looked at.
        first: slots before are left out of the statistics.
        num_slots: how much of it; all by default.
    """
    num_slots = recording.num_slots if num_slots is None else num_slots
    tracks, _ = all_camera_tracks(recording, num_slots)
    people = list(assign_detections(recording, tracks, num_slots))
    people = [_in_coco17(person, recording) for person in people]
    rig = recording.rig
    noise = load_noise(detector_of(recording)).in_images_of(IMAGE_PX)
    found = leave_one_out(people, rig, noise, recording.interval_s)
    errors = np.full((len(people), num_slots, len(rig), 17, 2), np.nan)
    place = found.series // 17
    errors[place // len(rig), found.slots, place % len(rig), found.series % 17] = found.errors_px
    bodies = np.full((num_slots, len(people), 17, 3), np.nan)
    scores = np.zeros((len(people), num_slots, len(rig), 17))
    found_px = np.full((len(people), num_slots, len(rig), 17, 2), np.nan)
    for index, person in enumerate(people):
        rows = slice(person.first_slot, person.first_slot + len(person.joints_m))
        bodies[rows, index] = person.joints_m
        scores[index, rows] = np.nan_to_num(person.scores)
        found_px[index, rows] = person.keypoints_px
    parts = [
        _camera_rows(
            recording, camera, bodies, errors[:, :, camera], scores, found_px[:, :, camera], first
        )
        for camera in range(len(rig))
    ]
    return Keypoints(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Keypoints)}
    )


def _in_coco17(person: Observed, recording: Recording) -> Observed:
    if recording.skeleton == COCO17:
        return person
    columns = [recording.skeleton.index(joint) for joint in COCO17.joints]
    joints_m, _ = convert(
        person.joints_m, np.ones(person.joints_m.shape[:-1]), recording.skeleton, COCO17
    )
    return Observed(
        person.first_slot,
        joints_m,
        person.keypoints_px[:, :, columns],
        person.scores[:, :, columns],
    )


def _camera_rows(
    recording: Recording,
    index: int,
    bodies: Floats,
    errors: Floats,
    scores: Floats,
    found_px: Floats,
    first: int,
) -> Keypoints:
    camera = recording.rig.cameras[index]
    num_slots = len(bodies)
    centre = camera.center_m
    others, own = covered_by_others(centre, bodies), covered_by_self(centre, bodies)
    inside = camera.sees(bodies)
    pixels = camera.project(bodies)
    hips = bodies[:, :, 11:13].mean(axis=2)
    depth = np.linalg.norm(hips - centre, axis=-1)
    focal = 0.5 * (camera.K[0, 0] + camera.K[1, 1])
    scale = max(camera.image_size) / IMAGE_PX
    cm_per_px = 100 * depth / focal * scale  # of a pixel of an image of IMAGE_PX
    low, high = np.nanmin(pixels, axis=2), np.nanmax(pixels, axis=2)
    nearer = depth[:, None, :] < depth[:, :, None] - 0.2
    within = (pixels[:, :, None] > low[:, None, :, None]) & (
        pixels[:, :, None] < high[:, None, :, None]
    )  # (slots, people, nearer people, joints, 2)
    boxed = (within.all(axis=-1) & nearer[..., None]).any(axis=2)
    left = bodies[:, :, 5] - bodies[:, :, 6] + bodies[:, :, 11] - bodies[:, :, 12]
    ahead = np.arctan2(-left[..., 0], left[..., 1])
    towards = (centre - hips)[..., :2]
    azimuth = np.arctan2(towards[..., 1], towards[..., 0]) - ahead
    sector = np.rint(np.nan_to_num(azimuth) / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS
    mirror, front = _alternatives(pixels, nearer, found_px)
    speed = np.linalg.norm(np.gradient(hips, recording.interval_s, axis=0), axis=-1)
    own_score = scores[:, :, index]
    seen = own_score > LEAST_SCORE
    known = np.isfinite(errors[..., 0])
    elsewhere = _supported(scores, index, recording.interval_s) & inside.transpose(1, 0, 2)
    rows = (known | (elsewhere & ~seen)) & (np.arange(num_slots) >= first)[:, None]
    people, slots, joints = np.nonzero(rows)
    error_px = errors[people, slots, joints]
    number = (people * len(recording.rig) + index) * 17 + joints
    return Keypoints(
        error_px,
        error_px * cm_per_px[slots, people, None],
        own_score[people, slots, joints],
        joints,
        np.full(len(slots), index),
        number,
        slots,
        sector[slots, people],
        others[slots, people, joints],
        own[slots, people, joints],
        boxed[slots, people, joints],
        seen[people, slots, joints],
        np.asarray(seen.any(axis=-1))[people, slots],
        mirror[slots, people, joints] * cm_per_px[slots, people] / scale,
        front[slots, people, joints] * cm_per_px[slots, people] / scale,
        speed[slots, people],
    )


def _alternatives(pixels: Floats, nearer: Flags, found_px: Floats) -> tuple[Floats, Floats]:
    """Return `(num_slots, num_people, 17)` twice: pixels from keypoints to what they may show."""
    found = found_px.transpose(1, 0, 2, 3)
    mirror = np.linalg.norm(found - pixels[:, :, MIRRORED], axis=-1)
    front = np.full(mirror.shape, np.inf)
    for person in range(pixels.shape[1]):
        apart = np.linalg.norm(found - pixels[:, person : person + 1], axis=-1)
        before = nearer[:, :, person, None]
        front = np.fmin(front, np.where(before, apart, np.inf))
    return mirror, front


def _supported(scores: Floats, index: int, interval_s: float) -> Flags:
    """Return `(num_people, num_slots, 17)`: two other views saw the joint a moment ago."""
    from scipy.ndimage import maximum_filter1d

    reach = 2 * max(1, round(SUPPORT_S / interval_s)) + 1
    near = maximum_filter1d((scores > LEAST_SCORE).astype(np.int8), reach, axis=1, mode="constant")
    return np.asarray(near.sum(axis=2) - near[:, :, index] >= SUPPORT_VIEWS)


def capped(errors: Floats, most: float = WINSOR_CM) -> Floats:
    """Return errors `(num, 2)` of which none counts for more than `most`."""
    length = np.linalg.norm(errors, axis=-1, keepdims=True)
    return np.asarray(errors * np.minimum(1.0, most / np.maximum(length, 1e-9)))


def remembered(rows: Keypoints, interval_s: float, lags_s: Sequence[float] = LAGS_S) -> list[float]:
    """Return the correlation of errors with those of the same joint and view, by lag."""
    errors = capped(rows.error_cm)
    order = np.lexsort((rows.slot, rows.series))
    errors, series, slots = errors[order], rows.series[order], rows.slot[order]
    span = int(slots.max()) + 2 + 2 * round(max(lags_s) / interval_s)
    times = series * span + slots
    found = []
    for lag_s in lags_s:
        lag = max(1, round(lag_s / interval_s))
        later = np.searchsorted(times, times + lag)
        hit = later < len(times)
        hit[hit] &= times[later[hit]] == times[hit] + lag
        a, b = errors[hit], errors[later[hit]]
        norm = np.sqrt((a**2).sum() * (b**2).sum())
        found.append(float((a * b).sum() / norm) if norm > 0 else float("nan"))
    return found


def shared(rows: Keypoints) -> float:
    """Return how errors of one joint at one time correlate between two views, of any two."""
    errors = capped(rows.error_cm)
    cameras = int(rows.camera.max()) + 1
    joints = rows.series // 17 // cameras * 17 + rows.joint
    times = joints * (int(rows.slot.max()) + 1) + rows.slot
    _, place, views = np.unique(times, return_inverse=True, return_counts=True)
    total = np.stack([np.bincount(place, errors[:, axis]) for axis in (0, 1)], axis=-1)
    crossed = float((total**2).sum() - (errors**2).sum())
    return crossed / float((views * (views - 1)).sum()) / float((errors**2).sum(axis=1).mean())


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One recording: its keypoints and the seconds between its slots."""

    name: str
    keypoints: Keypoints
    interval_s: float


def figures(keypoints: Keypoints, interval_s: float) -> dict[str, float]:
    """Return the statistics by name; NaN where too few keypoints decide."""
    seen = keypoints.only(keypoints.seen)
    found = {
        "people met by a view, %": 100 * float(keypoints.met.mean()),
        **{
            f"hips move, {share} % below, m/s": float(np.nanpercentile(keypoints.speed_mps, share))
            for share in (50, 90)
        },
        **dict(_by_group(keypoints, interval_s)),
        "all: scores below .3, %": 100 * float((seen.score < 0.3).mean()),
        "all: scores above .85, %": 100 * float((seen.score > 0.85).mean()),
    }
    for lag_s, value in zip(LAGS_S, remembered(seen, interval_s), strict=True):
        found[f"all: correlation after {lag_s:g} s"] = value
    found["two views at one time: correlation"] = shared(seen)
    cameras = [seen.only(seen.camera == camera) for camera in np.unique(seen.camera)]
    after = [remembered(mine, interval_s, (1.0,))[0] for mine in cameras]
    found["one camera, least: correlation after 1 s"] = min(after)
    found["one camera, most: correlation after 1 s"] = max(after)
    for low, high in ((0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 1.01)):
        inside = (seen.score >= low) & (seen.score < high)
        found[f"score {low:g} to {min(high, 1):g}: median cm"] = _median(seen.only(inside))
    for part, joints in PARTS.items():
        mine = seen.only(np.isin(seen.joint, list(joints)))
        found[f"{part}: median cm"] = _median(mine)
        found[f"{part}: mean error by direction of view, cm"] = by_direction(mine)
        met = keypoints.only(np.isin(keypoints.joint, list(joints)) & keypoints.met)
        found[f"{part}: missed, %"] = 100 * float((~met.seen).mean())
    return found


def _by_group(keypoints: Keypoints, interval_s: float) -> Iterator[tuple[str, float]]:
    for group, chosen in GROUPS.items():
        all_of_them = keypoints.only(chosen(keypoints) & keypoints.met)
        mine = all_of_them.only(all_of_them.seen)
        enough = len(mine.seen) >= LEAST
        cm = np.linalg.norm(mine.error_cm, axis=-1)
        px = np.linalg.norm(mine.error_px, axis=-1)
        wild = cm > GROSS_CM
        yield f"{group}: missed, %", 100 * float((~all_of_them.seen).mean())
        yield f"{group}: median cm", _median(mine)
        for label, gross in ((f"{GROSS_PX:g} px", px > GROSS_PX), (f"{GROSS_CM:g} cm", wild)):
            yield f"{group}: beyond {label}, %", 100 * float(gross.mean()) if enough else np.nan
        for share in (10, 50, 90):
            value = float(np.percentile(mine.score, share)) if enough else np.nan
            yield f"{group}: score, {share} % below", value
        for lag_s, value in zip(LAGS_S, remembered(mine, interval_s), strict=True):
            yield f"{group}: correlation after {lag_s:g} s", value
        limbs = wild & (mine.joint >= 7) & ~np.isin(mine.joint, (11, 12))
        for what, apart in (("the one before", mine.front_cm), ("the other side", mine.mirror_cm)):
            on_it = apart[limbs] < 0.5 * cm[limbs]
            value = 100 * float(on_it.mean()) if len(on_it) >= 30 else np.nan
            yield f"{group}: of gross errors of limbs on {what}, %", value


def _median(mine: Keypoints) -> float:
    if len(mine.seen) < LEAST:
        return float("nan")
    return float(np.median(np.linalg.norm(mine.error_cm, axis=-1)))


def by_direction(mine: Keypoints) -> float:
    """Return the root mean square of a joint's mean error over the directions of view, in cm."""
    errors, total, number = capped(mine.error_cm), 0.0, 0
    for joint in np.unique(mine.joint):
        for sector in range(SECTORS):
            rows = (mine.joint == joint) & (mine.sector == sector)
            if rows.sum() >= LEAST:
                total += float((errors[rows].mean(axis=0) ** 2).sum()) * int(rows.sum())
                number += int(rows.sum())
    return float(np.sqrt(total / number)) if number else float("nan")


def real(named: Sequence[str]) -> Iterator[tuple[str, Recording, int | None]]:
    """Yield recordings: those of `E3POSE_SHARED` and those named by the user."""
    shared = os.environ.get("E3POSE_SHARED")
    if shared:
        from e3pose_lab.datasets.shelf import import_shelf

        yield "Shelf", import_shelf(Path(shared) / "data/shelf/shelf.npz"), None
        pizza = load_recording(Path(shared) / "data/pizza/recording")
        yield "pizza, first half", pizza, pizza.num_slots // 2
    for word in named:
        name, _, folder = word.partition("=")
        yield name, load_recording(Path(folder)), None


def simulated(
    word: str,
    seed: int,
    changes: Mapping[str, float] | None = None,
    seconds: float = SECONDS,
    fps: float | None = None,
) -> Recording:
    """Return a scene with errors by situation (`+`), by score (`-`), its own, or `bent` ones."""
    from e3pose.simulate import SCENES, Guessing, SceneSettings, adjusted, simulate

    if word.endswith(("~", "^")):
        recording = simulated(word[:-1], seed, changes, seconds, fps)
        return bent(recording, seed, SURE_SCORE if word.endswith("^") else None)
    scene = word.rstrip("+-")
    detector = SCENES[scene].detector
    if word.endswith("+"):
        detector = replace(detector, guessing=Guessing())
    if word.endswith("-"):
        detector = replace(detector, guessing=None)
    fps = fps or min(FPS, SCENES[scene].fps)
    detector = adjusted(detector, changes or {})
    return simulate(SceneSettings(scene=scene, seconds=seconds, fps=fps, detector=detector), seed)


def bent(recording: Recording, seed: int, score: float | None = None) -> Recording:
    """Return a simulated recording in which the errors of the first camera last.

    What it detects stays, but lies where the truth is, off by `BENT_PX` that persist for
    `BENT_S`: a consistent picture of people in the wrong place.

    Args:
        recording: with truth.
        seed: of the errors.
        score: of all of its keypoints; None leaves them as they are.
    """
    assert recording.truth is not None
    people_m, views = recording.truth.joints_m, recording.views[0]
    pixels = recording.rig.cameras[0].project(people_m)
    rng, dt = np.random.default_rng(seed), recording.interval_s
    errors = correlated(rng, pixels.shape, dt, ((0.5, BENT_S),))  # of each joint
    errors += correlated(rng, (*pixels.shape[:2], 1, 2), dt, ((0.5, BENT_S),))  # of the body
    pixels = pixels + BENT_PX * errors
    bent_views = []
    for slot in views.slots.tolist():
        view = views.view(slot)
        assert view is not None
        apart = np.linalg.norm(pixels[slot][None] - view.keypoints_px[:, None], axis=-1)
        there = np.isfinite(apart)
        apart = np.where(there, apart, 0.0).sum(axis=-1) / np.maximum(there.sum(axis=-1), 1)
        nearest = np.where(there.any(axis=-1), apart, np.inf).argmin(axis=1)
        seen = (view.scores > 0) & np.isfinite(pixels[slot][nearest]).all(axis=-1)
        bent_views.append(
            Poses2D(
                np.where(seen[..., None], pixels[slot][nearest], np.nan),
                np.where(seen, view.scores if score is None else score, 0.0),
            )
        )
    series = ViewSeries.from_views(
        bent_views, views.slots.tolist(), views.times_s.tolist(), len(recording.skeleton)
    )
    return replace(recording, views=(series, *recording.views[1:]))


def table(columns: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Yield a table in Markdown, a row per statistic."""
    yield "| | " + " | ".join(columns) + " |"
    yield "|---|" + "---|" * len(columns)
    for row in next(iter(columns.values())):
        cells = [_text(column[row]) for column in columns.values()]
        yield f"| {row} | {' | '.join(cells)} |"


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=SCENES)
    parser.add_argument("--recording", action="append", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    columns = [
        Column(name, gather(recording, num_slots=slots), recording.interval_s)
        for name, recording, slots in real(options.recording)
    ]
    for word in options.scenes.split(","):
        recording = simulated(word, options.seed)
        columns.append(Column(word, gather(recording), recording.interval_s))
    for line in table({c.name: figures(c.keypoints, c.interval_s) for c in columns}):
        print(line)


if __name__ == "__main__":
    main()
