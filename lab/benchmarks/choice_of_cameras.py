"""Round robin against `information` and chance: real recordings first, simulated scenes after.

    python lab/benchmarks/choice_of_cameras.py --recording PIZZA,CLIP --scenes buffet --leads 1,4
    python lab/benchmarks/choice_of_cameras.py --recording RECORDING --seconds 15 --rates 30

Ten joints count: shoulders, elbows, wrists, hips and knees. `off mm` is their mean distance from
the offline smoother over all cameras (`clip_error.py`), which real recordings have, too; `MPJPE mm`
that from the truth. People are matched one to one below half a metre; `recall %` is the share of
the smoother's people found. Cells are round robin / `information` / random, with the standard
deviation over seeds, which are phases of the turns on real recordings; `gain %` is how much nearer
`information` is than round robin, paired by seed. `--cameras 1,40mm` has a target error beside a
number; `awake` is how many cameras were. A scene with `+` has errors by situation, one with `-`
errors by score alone. A rate above a recording's own is the recording's. Every line of `--out` is
one replay; a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from clip_error import Reference, references
from detector_errors import simulated
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.simulate.detections import until

Floats = NDArray[np.float64]
Row = dict[str, Any]

POLICIES = ("round-robin", "information", "random")
JOINTS = [
    f"{side}_{part}"
    for part in ("shoulder", "elbow", "wrist", "hip", "knee")
    for side in ("left", "right")
]
SCENES = "round-table,buffet,reception,operating-room,lab"
SAME_M = 0.5
WARMUP = 10  # slots with all cameras, left out


def figures(
    recording: Recording, people: Sequence[Reference], policy: str, goal: str, lead: int, seed: int
) -> Row:
    """Replay once; return the figures."""
    columns = [recording.skeleton.index(joint) for joint in JOINTS]
    truth = recording.truth
    target_mm = goal.removesuffix("mm") if goal.endswith("mm") else None
    settings = ReplaySettings(
        pipeline="memory", policy=policy, lead_slots=lead, seed=seed, phase=seed,
        num_selected=float(goal) if target_mm is None else len(recording.rig),
        target_error_m=None if target_mm is None else float(target_mm) / 1000,
        warmup_slots=WARMUP,
    )  # fmt: skip
    off: list[Floats] = []
    wrong: list[Floats] = []
    found = there = slots = awake = 0
    for record in replay(recording, settings):
        if record.slot < WARMUP + lead - 1:
            continue
        slots, awake = slots + 1, awake + int(record.selected.sum())
        expected = np.array([person.at(record.slot) for person in people])[:, columns]
        expected = expected[np.isfinite(expected).any(axis=(1, 2))]
        joints_m = record.poses.joints_m[:, columns]
        near = matched(joints_m, expected)
        off += near
        found, there = found + len(near), there + len(expected)
        if truth is not None:
            wrong += matched(joints_m, truth.joints_m[record.slot][:, columns])
    return {
        "awake": awake / max(slots, 1),
        "off_mm": 1000 * float(np.concatenate(off).mean()) if off else None,
        "recall": found / max(there, 1),
        "mpjpe_mm": 1000 * float(np.concatenate(wrong).mean()) if wrong else None,
    }


def matched(joints_m: Floats, expected_m: Floats) -> list[Floats]:
    """Return the distances of known joints of each pair of people, `(num_joints,)` each."""
    if not len(joints_m) or not len(expected_m):
        return []
    apart = np.nan_to_num(mean_errors_m(joints_m, expected_m), nan=np.inf)
    rows, columns = linear_sum_assignment(np.minimum(apart, 1e3))
    pairs = []
    for row, column in zip(rows, columns, strict=True):
        if apart[row, column] < SAME_M:
            off = np.linalg.norm(joints_m[row] - expected_m[column], axis=-1)
            pairs.append(off[np.isfinite(off)])
    return pairs


def measure(options: argparse.Namespace) -> Iterator[Row]:
    """Yield the rows that are not in the file yet."""
    done = read(options.out)
    have = {(r["place"], r["fps"], r["seed"], r["policy"], r["goal"], r["lead"]) for r in done}
    goals = options.cameras.split(",")
    runs = [
        (policy, goal)
        for goal in goals
        for policy in options.policies.split(",")
        if policy == "information" or not goal.endswith("mm")
    ]
    leads = [int(lead) for lead in options.leads.split(",")]
    for place in places(options):
        for seed in (int(seed) for seed in options.seeds.split(",")):
            for fps in (float(rate) for rate in options.rates.split(",")):
                key = (place, fps, seed)
                todo = [
                    (*run, lead) for lead in leads for run in runs if (*key, *run, lead) not in have
                ]
                if not todo:
                    continue
                recording = made(options, place, fps, seed)
                people = references(recording, load_noise(detector_of(recording)))
                for policy, goal, lead in todo:
                    row = figures(recording, people, policy, goal, lead, seed % 1000)
                    yield {
                        "place": place, "fps": fps, "seed": seed, "policy": policy,
                        "goal": goal, "lead": lead, **row,
                    }  # fmt: skip


def places(options: argparse.Namespace) -> list[str]:
    """Return real recordings, then scenes."""
    real = options.recording.split(",") if options.recording else []
    scenes = options.scenes or ("" if real else SCENES)
    return real + scenes.split(",") * bool(scenes)


def made(options: argparse.Namespace, place: str, fps: float, seed: int) -> Recording:
    """Return the recording: simulated, or the first seconds of a real one."""
    if not Path(place).is_dir():
        return simulated(place, seed, seconds=options.seconds, fps=fps)
    whole = load_recording(Path(place))
    slots = min(whole.num_slots, round(options.seconds / whole.interval_s))
    views = tuple(until(series, slots) for series in whole.views)
    recording = replace(whole, num_slots=slots, views=views, truth=None)
    return downsampled(recording, min(fps, whole.fps))


def read(out: Path) -> list[Row]:
    """Read what was measured before."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def report(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table in Markdown."""
    columns = (
        "place | slots/s | lead | goal | seeds | awake | off mm | gain % | MPJPE mm | recall %"
    )
    yield f"| {columns} |"
    yield "|---" * len(columns.split("|")) + "|"
    for place in dict.fromkeys(row["place"] for row in rows):
        keys = {(r["fps"], r["lead"], r["goal"]) for r in rows if r["place"] == place}
        for key in sorted(keys):
            mine = [
                r for r in rows if (r["place"], r["fps"], r["lead"], r["goal"]) == (place, *key)
            ]
            cells = [
                " / ".join(_mean(mine, policy, field, factor) for policy in POLICIES)
                for field, factor in (("off_mm", 1.0), ("mpjpe_mm", 1.0), ("recall", 100.0))
            ]
            cells.insert(1, _gain(mine))
            awake = [row["awake"] for row in mine if row["policy"] == "information"]
            start = [Path(place).name, *(f"{k:g}" if isinstance(k, float) else str(k) for k in key)]
            start += [str(len({row["seed"] for row in mine})), f"{np.mean(awake or [np.nan]):.2f}"]
            yield f"| {' | '.join([*start, *cells])} |"


def _mean(rows: Sequence[Row], policy: str, field: str, factor: float) -> str:
    values = [row[field] for row in rows if row["policy"] == policy and row[field] is not None]
    if not values:
        return "-"
    spread = f" ± {factor * np.std(values, ddof=1):.1f}" if len(values) > 1 else ""
    return f"{factor * np.mean(values):.1f}{spread}"


def _gain(rows: Sequence[Row]) -> str:
    """Return by how much `information` is nearer than round robin, and its spread over seeds."""
    off = {(row["policy"], row["seed"]): row["off_mm"] for row in rows if row["off_mm"]}
    gains = [
        100 * (1 - mine / off["round-robin", seed])
        for (policy, seed), mine in off.items()
        if policy == "information" and ("round-robin", seed) in off
    ]
    if not gains:
        return "-"
    spread = f" ± {np.std(gains, ddof=1):.1f}" if len(gains) > 1 else ""
    return f"{np.mean(gains):+.1f}{spread}"


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", help=f"default without a recording: {SCENES}")
    parser.add_argument("--recording", help="real ones, with commas")
    parser.add_argument("--rates", default="6,12.5,25", help="slots per second")
    parser.add_argument("--cameras", default="1,2,3", help="per slot; or a target error, 40mm")
    parser.add_argument("--policies", default=",".join(POLICIES))
    parser.add_argument("--seeds", default="801,802", help="of a recording: phases of the turns")
    parser.add_argument("--seconds", type=float, default=16.0)
    parser.add_argument("--leads", default="4")
    parser.add_argument("--out", type=Path, default=Path("choice.jsonl"))
    options = parser.parse_args()
    with options.out.open("a") as file:
        for row in measure(options):
            file.write(json.dumps(row) + "\n")
            file.flush()
    for line in report(read(options.out)):
        print(line)


if __name__ == "__main__":
    main()
