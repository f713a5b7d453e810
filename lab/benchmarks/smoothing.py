"""What waiting is worth: error and jitter of poses at once, 200 ms later, and after the fact.

    python lab/benchmarks/smoothing.py [--seeds 701 702 703 704] [--held-out] [--what scenes]
    python lab/benchmarks/smoothing.py --what situations cmu pizza --policy round-robin --lag 0.08

Motion capture (Panoptic, CMU), Shelf and pizza need the recordings that E3POSE_SHARED names.

A table of MPJPE (mm), the 95 % quantile (mm), acceleration error (m/s2) and the share of joints in
their 90 % band, by cameras per slot: the causal filter, the smoother over bodies with 200 ms and
with everything that comes later, and smoothers of the kept poses alone. Simulated people in ten
scenes, people who move as the Panoptic sequence before a ring of cameras, and PCP on Shelf; scenes
with errors by situation, CMU motion capture, and 15 s of pizza against the smoother of all views.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from e3pose_lab.datasets import shared_folder

SCENES = (
    "two-rooms",
    "l-hall",
    "shaft",
    "one-sided",
    "poor-view",
    "unequal-batteries",
    "dying-cameras",
    "slow",
    "ring",
    "pillar",
)
SECONDS, FPS = 16.0, 12.5
PIZZA_S = 15.0
KEYS = ("mpjpe_mm", "p95_mm", "acceleration_error_mps2", "coverage_90")


def simulated(seeds: Sequence[int]) -> Iterator[Any]:
    """Yield recordings of the ten scenes, at 12.5 slots per second or the scene's own rate."""
    from e3pose.simulate import SCENES as ALL
    from e3pose.simulate import SceneSettings, simulate

    for scene in SCENES:
        fps = FPS if ALL[scene].fps > FPS else None
        for seed in seeds:
            yield simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), seed)


def panoptic(shared: Path) -> Iterator[Any]:
    """Yield recordings of people who move as the Panoptic sequence, 30 slots per second."""
    from predictor_in_the_loop import captured, seen

    for kind, joints_m in captured(shared):
        if kind == "Panoptic":
            yield seen(joints_m, 30.0)


def situations() -> Iterator[Any]:
    """Yield scenes whose detector errs by situation, so that its errors last."""
    from e3pose.simulate import SceneSettings, simulate
    from e3pose.simulate.scenes import GUESSES

    for scene, seed in (("ring", 701), ("ring", 702), ("pillar", 701)):
        settings = SceneSettings(scene=scene, seconds=SECONDS, fps=FPS, detector=GUESSES)
        yield simulate(settings, seed)
    for scene in ("round-table", "lab"):
        yield simulate(SceneSettings(scene=scene, seconds=SECONDS), 702)


def cmu(shared: Path) -> Iterator[Any]:
    """Yield recordings of people who move as CMU motion capture, 30 slots per second."""
    from predictor_in_the_loop import captured, seen

    for kind, joints_m in captured(shared):
        if kind == "CMU":
            yield seen(joints_m, 30.0)


def pizza(shared: Path) -> Iterator[Any]:
    """Yield 15 s of pizza; its truth is what the smoother of all views says."""
    from clip_error import references
    from e3pose.model.noises import detector_of, load_noise
    from e3pose.recording import Truth, load_recording
    from e3pose_lab.noise.calibrate import first_slots

    recording = load_recording(shared / "data/pizza/recording")
    recording = first_slots(recording, round(PIZZA_S * recording.fps))
    people = references(recording, load_noise(detector_of(recording)))
    shape = (recording.num_slots, len(people), len(recording.skeleton), 3)
    joints_m, names = np.full(shape, np.nan), tuple(f"person{i}" for i in range(len(people)))
    for index, each in enumerate(people):
        slots = slice(each.first_slot, each.first_slot + len(each.joints_m))
        joints_m[slots, index] = each.joints_m
    yield replace(recording, truth=Truth(recording.skeleton, names, joints_m))


def shelf(shared: Path) -> Iterator[Any]:
    """Yield the Shelf recording."""
    from e3pose_lab.datasets.shelf import import_shelf

    yield import_shelf(shared / "data/shelf/shelf.npz")


def figures(
    recording: Any, cameras: float, phase: int, policy: str, lag_s: float
) -> dict[str, dict[str, float]]:
    """Return the figures of one replay by way of smoothing."""
    from e3pose.estimate.smooth import SmoothSettings
    from e3pose.evaluate.figures import expected_figures, plain
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.smoothed import smooth_poses, smooth_records
    from e3pose.evaluate.summary import accuracy

    settings = ReplaySettings(policy=policy, num_selected=cameras, seed=phase, phase=phase)
    people: list[Any] = []
    records = list(replay(recording, settings, publish=people.append))
    posteriors = [each.posterior for each in people]
    skeleton, interval_s = recording.skeleton, recording.interval_s
    lag = max(1, int(lag_s / interval_s + 1e-6))
    found = {
        "causal": records,
        f"rts, {1000 * lag_s:.0f} ms": smooth_records(records, posteriors, skeleton, lag),
        "rts, all": smooth_records(records, posteriors, skeleton),
        **{
            f"kept, {method}": smooth_poses(records, skeleton, interval_s, SmoothSettings(method))
            for method in ("rts", "butterworth", "one-euro")
        },
    }
    result = {}
    for way, late in found.items():
        scores = {**plain(expected_figures(recording, late)), **plain(accuracy(recording, late))}
        result[way] = {key: scores[key] for key in KEYS if key in scores}
        if "pcp" in scores:
            result[way]["pcp"] = scores["pcp"]["average"]
    return result


def table(
    name: str, recordings: Sequence[Any], phases: Sequence[int], policy: str, lag_s: float
) -> None:
    """Print the rows of one kind of recordings."""
    for count in (1, 2, None):
        found = [
            figures(recording, count or len(recording.rig), phase, policy, lag_s)
            for recording in recordings
            for phase in (phases if count else phases[:1])
        ]
        base: dict[str, float] = {}
        for way in found[0]:
            means = {
                key: float(np.mean([one[way][key] for one in found if key in one[way]]))
                for key in (*KEYS, "pcp")
                if any(key in one[way] for one in found)
            }
            base = base or means
            cells = [
                f"{means['mpjpe_mm']:.1f}",
                f"{100 * (means['mpjpe_mm'] / base['mpjpe_mm'] - 1):+.0f} %",
                f"{means['p95_mm']:.0f}",
                f"{means[KEYS[2]]:.2f}" if KEYS[2] in means else "",
                f"{100 * (means[KEYS[2]] / base[KEYS[2]] - 1):+.0f} %" if KEYS[2] in means else "",
                f"{means['coverage_90']:.0f}" if "coverage_90" in means else "",
                f"{means['pcp']:.2f}" if "pcp" in means else "",
            ]
            print(f"| {name}, {count or 'all'} | {way} | {' | '.join(cells)} |", flush=True)


def cost() -> None:
    """Print what a fixed lag of 200 ms takes, four people at 25 slots per second."""
    from e3pose.estimate.smooth.delayed import Delayed
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.simulate import SceneSettings, simulate

    recording = simulate(SceneSettings(scene="ring", people=4, seconds=8, fps=25), 705)
    people: list[Any] = []
    records = list(replay(recording, ReplaySettings(num_selected=2), publish=people.append))
    delayed = Delayed(recording.skeleton.joints, 5)
    took_ms = []
    for record, each in zip(records, people, strict=True):
        begun_s = time.process_time()
        delayed.push(record, each.posterior)
        if len(each.track_ids):
            took_ms.append(1000 * (time.process_time() - begun_s) / len(each.posterior.tracks))
    p50, p95 = np.percentile(took_ms, [50, 95])
    print(f"200 ms of lag: {p50:.2f} ms per person and slot, 95 % below {p95:.2f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=(701, 702, 703, 704))
    parser.add_argument("--policy", default="information")
    parser.add_argument("--lag", type=float, default=0.2, help="seconds")
    parser.add_argument("--held-out", action="store_true", help="seeds 1003 and 1004")
    parser.add_argument(
        "--what", nargs="+", default=("scenes", "panoptic", "shelf"),
        choices=("scenes", "panoptic", "shelf", "situations", "cmu", "pizza", "cost"),
    )  # fmt: skip
    options = parser.parse_args()
    if "cost" in options.what:
        cost()
        return
    real = {"panoptic": panoptic, "cmu": cmu, "pizza": pizza, "shelf": shelf}
    shared = shared_folder() if set(real) & set(options.what) and not options.held_out else None
    print("| what, cameras | poses | MPJPE | | p95 | acceleration | | in 90 % | PCP |")
    print("|---" * 9 + "|")
    seeds = (1003, 1004) if options.held_out else options.seeds
    how = options.policy, options.lag
    if "scenes" in options.what:
        table("ten scenes", list(simulated(seeds)), (1,), *how)
    if "situations" in options.what:
        table("errors by situation", list(situations()), (1,), *how)
    if shared is not None:
        names = {"panoptic": "Panoptic motion", "cmu": "CMU motion", "shelf": "Shelf"}
        phases = {"shelf": (0, 1, 2, 3, 4)}
        for name in [each for each in real if each in options.what]:
            found = list(real[name](shared))
            table(names.get(name, name), found, phases.get(name, (0, 1)), *how)


if __name__ == "__main__":
    main()
