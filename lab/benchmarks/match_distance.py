"""How far apart two views of one person may be: what `--pipeline paper` finds, by its threshold.

    python lab/benchmarks/match_distance.py --plot docs/images/match-distance.svg
    python lab/benchmarks/match_distance.py --matcher epipolar

The matcher `rays` has `--match-distance`, in metres between rays; the paper's, `epipolar`, has
`--epipolar-px`, in pixels from epipolar lines.

Simulated scenes: rings of cameras, and an operating room, whose wide lenses are close to people who
stand around a table; each with the noise of OpenPose, and of a detector that errs twice as far.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

DISTANCES = {
    "rays": (0.05, 0.075, 0.10, 0.125, 0.15, 0.175, 0.20, 0.25),
    "epipolar": (5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0),
}
SEEDS = (701, 702, 703, 704)
SECONDS, FPS = 10.0, 12.5
FOUND_M = 0.2  # of a person, as a mean over the joints
RING, ROOM = ("ring", "crossing", "pillar"), "operating room"
NOISES = (1.0, 2.0)  # factors on what OpenPose errs by
ROOM_PEOPLE = 5
FIGURES = ("recall", "precision", "F1", "MPJPE")


def operating_room() -> Any:
    """Return six cameras under the ceiling of a room of 6 m x 5 m, all of 100 degrees."""
    from e3pose.model.rigs import Spot, spot_rig

    corners = [(x, y) for x in (-2.9, 2.9) for y in (-2.4, 2.4)]
    spots = [Spot(x, y, 2.5, 0.1 * x, 0.1 * y, 100.0) for x, y in (*corners, (0, -2.4), (0, 2.4))]
    return spot_rig(spots, (1032, 776), np.random.default_rng(0))[0]


def recordings(scene: str, noise: float, seeds: Sequence[int]) -> list[Any]:
    """Return one recording a seed."""
    from e3pose.simulate import DetectorSettings, SceneSettings, simulate

    detector = DetectorSettings(noise=noise)
    where: dict[str, Any] = {"scene": scene}
    if scene == ROOM:
        where = {"scene": "meeting", "rig": operating_room(), "people": ROOM_PEOPLE}
    settings = SceneSettings(**where, seconds=SECONDS, fps=FPS, detector=detector)
    return [simulate(settings, seed) for seed in seeds]


def figures(
    recording: Any, matcher: str, distance: float, cameras: int | None, seed: int
) -> list[float]:
    """Return the `FIGURES`: shares found and right within `FOUND_M` in percent, and mm."""
    from e3pose.evaluate.metrics import candidates, first_matches, mpjpe_mm
    from e3pose.evaluate.replay import ReplaySettings, replay

    records = list(
        replay(
            recording,
            ReplaySettings(
                pipeline="paper", fill=False, policy="all" if cameras is None else "round-robin",
                num_selected=cameras or 1, warmup_slots=0, phase=seed,
                matcher=matcher,
                match_distance_m=distance if matcher == "rays" else None,
                epipolar_px=distance if matcher == "epipolar" else None,
            ),
        )
    )  # fmt: skip
    people = [record.poses.joints_m for record in records]
    scores = [record.poses.scores.mean(axis=-1) for record in records]
    found = candidates(people, scores, recording.truth.joints_m)
    right = float(first_matches(found, FOUND_M).sum())
    recall, precision = right / found.num_truths, right / max(len(found.errors_m), 1)
    harmonic = 2 * right / (found.num_truths + len(found.errors_m))
    return [100 * recall, 100 * precision, 100 * harmonic, mpjpe_mm(found) or np.nan]


def measure(
    matcher: str, seeds: Sequence[int]
) -> dict[tuple[str, float, int | None], NDArray[np.float64]]:
    """Return `(num_seeds, num_distances, num_figures)` of each scene, noise and camera count."""
    found = {}
    for scene in (*RING, ROOM):
        for noise in NOISES:
            made = recordings(scene, noise, seeds)
            for cameras in (None, 3):
                found[scene, noise, cameras] = np.array(
                    [
                        [figures(r, matcher, d, cameras, s % 100) for d in DISTANCES[matcher]]
                        for r, s in zip(made, seeds, strict=True)
                    ]
                )
                report(
                    f"{scene}, noise {noise:g}, {cameras or 'all'}", found[scene, noise, cameras]
                )
    return found


def report(title: str, values: NDArray[np.float64]) -> None:
    """Print one row of the table: `FIGURES` by distance, means over seeds."""
    means = values.mean(axis=0)
    cells = [f"{r:.1f} / {p:.1f} / {error:.1f}" for r, p, _, error in means]
    print(f"| {title} | {' | '.join(cells)} |", flush=True)


def draw(
    path: Path, matcher: str, found: dict[tuple[str, float, int | None], NDArray[np.float64]]
) -> None:
    """Draw recall, precision and MPJPE against the distance, scenes of one kind together."""
    from e3pose.evaluate.drawing import COLOURS, MARKERS, legend_above, picture

    with picture(path, 7.2, 2.6) as figure:
        panels = figure.subplots(1, 3)
        kinds = [(room, noise) for room in (False, True) for noise in NOISES]
        for number, (room, noise) in enumerate(kinds):
            mine = [v for (s, n, c), v in found.items() if (s == ROOM, n, c) == (room, noise, 3)]
            means = np.mean([values.mean(axis=0) for values in mine], axis=0)
            label = f"{ROOM if room else 'rings'}, noise x {noise:g}"
            for axes, column in zip(panels, (0, 1, 3), strict=True):
                axes.plot(
                    np.array(DISTANCES[matcher]) * (1000 if matcher == "rays" else 1),
                    means[:, column], label=label,
                    color=COLOURS[number], marker=MARKERS[number],
                )  # fmt: skip
        titles = ("recall at 200 mm, %", "precision at 200 mm, %", "MPJPE, mm")
        for axes, title in zip(panels, titles, strict=True):
            axes.set_title(title)
            axes.set_xlabel("match distance, " + ("mm" if matcher == "rays" else "px"))
        legend_above(figure, 4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--matcher", choices=list(DISTANCES), default="rays")
    options = parser.parse_args()
    rays = options.matcher == "rays"
    names = [f"{1000 * d:g} mm" if rays else f"{d:g} px" for d in DISTANCES[options.matcher]]
    print(f"| scene, noise, cameras | {' | '.join(names)} |")
    print("|---" * (len(names) + 1) + "|")
    found = measure(options.matcher, options.seeds)
    report("mean", np.mean(list(found.values()), axis=0))
    harmonic = np.mean([values[:, :, 2] for values in found.values()], axis=0)
    spread = harmonic.std(axis=0, ddof=1) / np.sqrt(len(harmonic)) if len(harmonic) > 1 else None
    print("F1 of the mean, %:", np.round(harmonic.mean(axis=0), 2), "standard error:", spread)
    if options.plot is not None:
        draw(options.plot, options.matcher, found)


if __name__ == "__main__":
    main()
