"""Worth of waiting: error and jitter of poses at once, 200 ms later, and after the fact.

    python lab/benchmarks/smoothing.py --what panoptic pizza

Both need the recordings that E3POSE_SHARED names: people who move as the Panoptic sequence before a
ring of cameras, and 15 s of pizza against the smoother of all views.

A table of MPJPE (mm), the 95 % quantile (mm), acceleration error (m/s2) and the share of joints in
their 90 % band, by cameras per slot: the causal filter, the smoother over bodies with 200 ms and
with everything that comes later, and smoothers of the kept poses alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from e3pose_lab.datasets import shared_folder

PIZZA_S = 15.0
PHASES = 0, 1  # of the turns
KEYS = ("mpjpe_mm", "p95_mm", "acceleration_error_mps2", "coverage_90")


def panoptic(shared: Path) -> Iterator[Any]:
    """Yield recordings of people who move as the Panoptic sequence, 30 slots per second."""
    from predictor_in_the_loop import captured, seen

    for kind, joints_m in captured(shared):
        if kind == "Panoptic":
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


REAL = {"panoptic": ("Panoptic motion", panoptic), "pizza": ("pizza", pizza)}


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
    return result


def table(name: str, recordings: Sequence[Any], policy: str, lag_s: float) -> None:
    """Print the rows of one kind of recordings."""
    for count in (1, 2, None):
        found = [
            figures(recording, count or len(recording.rig), phase, policy, lag_s)
            for recording in recordings
            for phase in (PHASES if count else PHASES[:1])
        ]
        base: dict[str, float] = {}
        for way in found[0]:
            means = {
                key: float(np.mean([one[way][key] for one in found if key in one[way]]))
                for key in KEYS
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
            ]
            print(f"| {name}, {count or 'all'} | {way} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--policy", default="information")
    parser.add_argument("--lag", type=float, default=0.2, help="seconds")
    parser.add_argument("--what", nargs="+", default=tuple(REAL), choices=REAL)
    options = parser.parse_args()
    shared = shared_folder()
    print("| what, cameras | poses | MPJPE | | p95 | acceleration | | in 90 % |")
    print("|---" * 8 + "|")
    for name in options.what:
        title, read = REAL[name]
        table(title, list(read(shared)), options.policy, options.lag)


if __name__ == "__main__":
    main()
