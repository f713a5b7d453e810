"""What it is worth to count people's size in the image in the noise of keypoints.

    E3POSE_SHARED=... python lab/benchmarks/size_in_noise.py --cases tune --out tune.jsonl
    E3POSE_SHARED=... python lab/benchmarks/size_in_noise.py --cases judge --clip CLIP --out j.jsonl

Each of `--versions` is a power and whether each camera has a noise of its own: `0.5:1` takes the
standard deviation of a keypoint to grow with the root of the person's size in the image, and learns
a factor for each camera; `0:1` is the filter as it is. Cases and judges are those of
`filter_terms.py`, lead 4, one camera per slot; the first half of pizza, Panoptic motion and scenes
of seeds 701 and 702 for tuning, the second half, Shelf, the demo's clip and scenes of seeds 1501 to
1504 for judging, and `--cases worse` scenes in which the first camera is 12 px worse than drawn.
Cells are percent of the version as it is, more is worse, with the standard error over replays.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import e3pose.estimate.filter.allocation as allocation
from detector_errors import simulated
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.held_out import turns
from e3pose.recording import load_recording
from e3pose_lab.datasets import shared_folder
from e3pose_lab.datasets.shelf import import_shelf
from filter_terms import Case, cases, figures, truth_of
from predictor_in_the_loop import captured, seen

OPEN = ("round-table", "lab", "buffet", "operating-room", "reception", "ring", "crossing-")
WALLS = ("one-sided", "two-rooms", "l-hall")
POLICIES = ("round-robin", "information")


def chosen(what: str, clip: Path | None) -> Iterator[Case]:
    """Yield the cases of a set."""
    if what == "worse":
        for scene, seed in product(("ring", "round-table", "buffet", "lab"), (1601, 1602)):
            recording = worse(simulated(scene, seed, seconds=12.0, fps=12.5), seed)
            yield Case("one camera 12 px worse", recording, truth_of(recording))
        return
    shared = shared_folder()
    names = ("pizza", "Shelf") if what == "judge" else ("pizza",)
    yield from (c for c in cases(shared, (), what == "judge") if c.name.startswith(names))
    if what == "tune":
        for name, joints_m in captured(shared):
            for every, fps, lengths in (
                (5, 6.0, (80, 78)),
                (2, 15.0, (200, 198)),
                (1, 30.0, (300,)),
            ):
                for length in lengths if name == "Panoptic" else ():
                    recording = seen(joints_m[::every][:length], fps)
                    yield Case(f"motion {fps:g}", recording, truth_of(recording), 2)
        scenes = product((701, 702), (12.5,), (*OPEN, *WALLS))
    else:
        shelf = import_shelf(shared / "data/shelf/shelf.npz")
        for fps in (12.5, 6.0):
            yield Case(f"Shelf {fps:g}", downsampled(shelf, fps), None, 5)
        if clip is not None:
            for rest, by in turns(downsampled(load_recording(clip), 30.0), ["each"])[1:]:
                yield Case("clip 30", rest, None, 4, by)
        scenes = product((1501, 1502, 1503, 1504), (12.5, 6.0), (*OPEN, *WALLS))
    for seed, fps, scene in scenes:
        recording = simulated(scene, seed, seconds=12.0, fps=fps)
        yield Case(f"{scene} {fps:g}", recording, truth_of(recording))


def worse(recording: Any, seed: int) -> Any:
    """Return a recording whose first camera has 12 px more noise."""
    view = recording.views[0]
    noise_px = 12.0 * np.random.default_rng(seed).normal(size=view.keypoints_px.shape)
    first = replace(view, keypoints_px=view.keypoints_px + noise_px)
    return replace(recording, views=(first, *recording.views[1:]))


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", choices=["tune", "judge", "worse"], default="tune")
    parser.add_argument("--clip", type=Path, help="recording of the demo's videos")
    parser.add_argument("--versions", default="0:1,0.5:1,0.5:0,0:0")
    parser.add_argument("--out", type=Path, default=Path("size.jsonl"))
    options = parser.parse_args()
    done = options.out.read_text().splitlines() if options.out.exists() else []
    rows = {(r["case"], r["version"], r["policy"]): r for r in map(json.loads, done)}
    for number, case in enumerate(chosen(options.cases, options.clip)):
        for version, policy in product(options.versions.split(","), POLICIES):
            key = (f"{case.name}#{number}", version, policy)
            if key in rows:
                continue
            size, by_camera = map(float, version.split(":"))
            allocation.SWITCH.update(size=size, by_camera=by_camera)
            allocation.held_constants.cache_clear()
            mm = [figures(case, policy, 1.0, phase)["mm"] for phase in range(case.phases)]
            rows[key] = {**dict(zip(("case", "version", "policy"), key, strict=True)), "mm": mm}
            with options.out.open("a") as file:
                file.write(json.dumps(rows[key]) + "\n")
    names = dict.fromkeys(key[0].partition("#")[0] for key in rows)
    for policy, name in product(POLICIES, names):
        cells = [f"{policy} {name}"]
        for version in options.versions.split(","):
            changed = [
                100 * (now / before - 1)
                for (case, of, by), row in rows.items()
                if (case.partition("#")[0], of, by) == (name, version, policy)
                for now, before in zip(row["mm"], rows[case, "0:1", by]["mm"], strict=True)
            ]
            error = np.std(changed, ddof=1) / len(changed) ** 0.5
            cells.append(f"{np.mean(changed):+.1f} ± {error:.1f}")
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
