"""Errors of simulated detectors beside those of real ones, from detections alone.

    python lab/benchmarks/detector_errors.py --scenes buffet,round-table,ring-
    python lab/benchmarks/detector_errors.py --recording clip=FOLDER --scenes buffet --seed 901

A scene with `+` has errors by situation, one with `-` errors by score alone; without either, its
own. In one with `~` those of the first camera last for seconds and look consistent; with `^` that
camera gives all of them a score of 0.99 besides. Real ones are those of `E3POSE_SHARED`.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Flags
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries, load_recording
from e3pose.simulate.noise import correlated
from error_statistics import (
    GROSS_CM,
    GROSS_PX,
    LAGS_S,
    SECTORS,
    Keypoints,
    capped,
    gather,
    remembered,
    shared,
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
