"""Where does adaptive choice pay? Policies on simulated scenes, paired over seeds.

python lab/benchmarks/adaptive_choice.py --seeds 20 --out adaptive.jsonl
python lab/benchmarks/adaptive_choice.py --seeds 20 --lead 4 --out adaptive.jsonl

A live site decides 2 to 6 slots ahead: `--lead` takes several, and tables have a column for it.
Every line of the file is one seed of one scene at one lead; a run that was stopped goes on where
it was.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from paired import errors_with_misses, gain_percent, saving_percent

Floats = NDArray[np.float64]
Row = dict[str, Any]

PARTIAL = (
    "two-rooms", "l-hall", "shaft", "one-sided", "poor-view", "unequal-batteries",
    "dying-cameras", "slow",
)  # fmt: skip
SYMMETRIC = ("ring", "pillar")
NAMES = SPREAD, PAPER, ADAPTIVE = "round-robin", "e3pose", "information"
# Of every scene: which policy wakes how many cameras. The spread policy's curve says what energy
# it would take to be as good as the adaptive one.
RUNS = (
    *((SPREAD, count) for count in (1, 1.5, 2)),
    *((ADAPTIVE, count) for count in (1, 2)),
    (PAPER, 1),
)
SECONDS, FPS = 16.0, 12.5
LEADS = (1, 2, 4, 6)
FIRST_SEED = 1000  # none of these were looked at while scenes and policies were made
ACTIVE_W, IDLE_W = 12.5, 6.25  # of the shipped profile of the Xavier NX


def one(
    scene: str,
    seed: int,
    runs: Sequence[tuple[str, float]],
    seconds: float,
    people: int | None,
    leads: Sequence[int],
) -> list[Row]:
    """Simulate one scene and replay it under every policy and lead."""
    from e3pose.simulate import SCENES, SceneSettings, simulate

    fps = FPS if SCENES[scene].fps > FPS else None
    settings = SceneSettings(scene=scene, seconds=seconds, fps=fps, people=people)
    recording = simulate(settings, seed)
    of_scene = {"scene": scene, "seed": seed, "people": people, "seconds": seconds}
    return [
        {
            **of_scene,
            "lead": lead,
            "runs": [figures(recording, policy, count, seed, lead) for policy, count in runs],
        }
        for lead in leads
    ]


def figures(
    recording: Any, policy: str, count: float, seed: int, lead: int, pipeline: str = "memory"
) -> Row:
    """Replay once; the energy of batteries counts, and so does a lifetime of the recording."""
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import accuracy
    from e3pose.settings.faults import Faults

    num_cameras = len(recording.rig)
    budget, day = None, Faults()
    if recording.battery_wh:
        seconds = recording.num_slots * recording.interval_s
        watts = np.array(
            [3600 * recording.battery_wh[i] / seconds for i in recording.rig.camera_ids]
        )
        share = np.clip((watts - IDLE_W) / (ACTIVE_W - IDLE_W), 0.01, 1.0)
        budget = tuple(share.tolist()) if policy == ADAPTIVE else None
        day = Faults(watts=((ACTIVE_W,) * num_cameras, (IDLE_W,) * num_cameras))
    settings = ReplaySettings(
        pipeline=pipeline, policy=policy, num_selected=count, seed=seed % 1000, phase=seed % 1000,
        budget=budget, faults=day, lead_slots=lead,
    )  # fmt: skip
    records = list(replay(recording, settings))
    found = accuracy(recording, records)
    selected = np.stack([record.selected for record in records])
    seconds = recording.num_slots * recording.interval_s
    there = np.isfinite(recording.truth.joints_m[..., 0, 0]).sum() * recording.interval_s / 60
    precision = 1.0 if found.precision_500mm is None else found.precision_500mm
    return {
        "policy": policy,
        "count": count,
        "pipeline": pipeline,
        "cameras_on": float(selected.sum(axis=1).mean()),
        "active_j": float(selected.sum() * recording.interval_s * (ACTIVE_W - IDLE_W)),
        "device_j": float(
            selected.sum() * recording.interval_s * (ACTIVE_W - IDLE_W)
            + seconds * num_cameras * IDLE_W
        ),
        "mpjpe_mm": found.mpjpe_mm,
        "recall": found.recall_500mm,
        "false_percent": 100 * (1 - precision),
        "switches_per_person_minute": (found.id_switches or 0) / max(float(there), 1e-9),
    }


def measure(
    out: Path,
    scenes: Sequence[str],
    seeds: int,
    seconds: float,
    people: int | None,
    leads: Sequence[int],
    jobs: int,
) -> list[Row]:
    """Do what is not in the file yet, and return all of it."""
    from joblib import Parallel, delayed
    from rich.progress import track

    done = read(out)
    have = {(r["scene"], r["seed"], r["people"], r["seconds"], r["lead"]) for r in done}
    todo = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        for scene in scenes:
            left = [lead for lead in leads if (scene, seed, people, seconds, lead) not in have]
            if left:
                todo.append((scene, seed, left))
    results = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(one)(scene, seed, RUNS, seconds, people, left) for scene, seed, left in todo
    )
    with out.open("a") as file:
        for rows in track(results, "replay", total=len(todo), disable=not sys.stderr.isatty()):
            for row in rows:
                file.write(json.dumps(row) + "\n")
            file.flush()
            done.extend(rows)
    return done


def read(out: Path) -> list[Row]:
    """Read the lines that were written whole."""
    rows = []
    for line in out.read_text().splitlines() if out.exists() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            print(f"{out}: a line that was cut short is measured anew", file=sys.stderr)
    return rows


def of(rows: Sequence[Row], policy: str, count: float, field: str) -> list[Any]:
    """Return one figure of one run of every seed."""
    return [
        run[field]
        for row in rows
        for run in row["runs"]
        if (run["policy"], run["count"]) == (policy, count)
    ]


def errors(rows: Sequence[Row], policy: str, count: float) -> Floats:
    return errors_with_misses(
        of(rows, policy, count, "mpjpe_mm"), of(rows, policy, count, "recall")
    )


def report(rows: Sequence[Row], scenes: Sequence[str], leads: Sequence[int]) -> Iterator[str]:
    """Yield tables in Markdown: what adaptive choice is worth in every scene, and at every lead."""
    yield (
        "| scene | C | lead | seeds | MPJPE mm spread / paper / adaptive | recall % | "
        "gain over spread % | counting misses % | gain over paper % | "
        "energy saved at equal error % |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for scene in scenes:
        for lead in leads:
            mine = sorted(_at(rows, scene, lead), key=lambda row: int(row["seed"]))
            for count in (1, 2) if mine else ():
                yield _row(scene, count, lead, mine)
            for name in (SPREAD, ADAPTIVE) if mine else ():
                false = np.mean(of(mine, name, 2, "false_percent"))
                switches = np.mean(of(mine, name, 2, "switches_per_person_minute"))
                yield (
                    f"| {scene} | 2 | {lead} | | {name}: {false:.2f} % of the estimates are "
                    f"nobody, {switches:.2f} identity switches per person-minute | | | | | |"
                )
    yield ""
    yield "Gain over spread turns, %, mean of the scenes; counting misses; and recall, difference:"
    yield ""
    yield "| C | " + " | ".join(f"lead {lead}" for lead in leads) + " |"
    yield "|---|" + "---|" * len(leads)
    for count in (1, 2):
        cells = [_overall(rows, scenes, count, lead) for lead in leads]
        yield f"| {count} | {' | '.join(cells)} |"


def _at(rows: Sequence[Row], scene: str, lead: int) -> list[Row]:
    return [row for row in rows if (row["scene"], row["lead"]) == (scene, lead)]


def _overall(rows: Sequence[Row], scenes: Sequence[str], count: float, lead: int) -> str:
    gains, with_misses, recall = [], [], []
    for scene in scenes:
        mine = _at(rows, scene, lead)
        if mine:
            spread = np.array(of(mine, SPREAD, count, "mpjpe_mm"), dtype=np.float64)
            adaptive = np.array(of(mine, ADAPTIVE, count, "mpjpe_mm"), dtype=np.float64)
            gains.append(gain_percent(spread, adaptive).mean)
            missed = errors(mine, SPREAD, count), errors(mine, ADAPTIVE, count)
            with_misses.append(gain_percent(*missed).mean)
            found = [np.mean(of(mine, name, count, "recall")) for name in (ADAPTIVE, SPREAD)]
            recall.append(100 * (found[0] - found[1]))
    if not gains:
        return ""
    return f"{np.mean(gains):+.1f}; {np.mean(with_misses):+.1f}; {np.mean(recall):+.2f}"


def _row(scene: str, count: float, lead: int, rows: Sequence[Row]) -> str:
    names = [name for name in (SPREAD, PAPER, ADAPTIVE) if (name, count) in RUNS]
    error = {name: np.array(of(rows, name, count, "mpjpe_mm"), dtype=np.float64) for name in names}
    recall = {name: 100 * np.mean(of(rows, name, count, "recall")) for name in names}
    counts = [c for name, c in RUNS if name == SPREAD]
    saved = saving_percent(
        np.array([of(rows, SPREAD, c, "cameras_on") for c in counts]),
        np.array([of(rows, SPREAD, c, "mpjpe_mm") for c in counts], dtype=np.float64),
        np.array(of(rows, ADAPTIVE, count, "cameras_on")),
        error[ADAPTIVE],
    )
    cells = [
        scene,
        str(count),
        str(lead),
        str(len(rows)),
        " / ".join(f"{error[name].mean():.1f}" if name in error else "" for name in NAMES),
        " / ".join(f"{recall[name]:.1f}" if name in recall else "" for name in NAMES),
        _text(gain_percent(error[SPREAD], error[ADAPTIVE])),
        _text(gain_percent(errors(rows, SPREAD, count), errors(rows, ADAPTIVE, count))),
        _text(gain_percent(error[PAPER], error[ADAPTIVE])) if PAPER in error else "",
        "more than measured" if saved is None else _text(saved),
    ]
    return f"| {' | '.join(cells)} |"


def _text(interval: Any) -> str:
    return f"{interval.mean:+.1f} ({interval.low:+.1f} to {interval.high:+.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=",".join((*PARTIAL, *SYMMETRIC)))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--people", type=int)
    parser.add_argument("--lead", default=",".join(map(str, LEADS)), help="slots ahead, several")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--out", type=Path, default=Path("adaptive.jsonl"))
    options = parser.parse_args()
    scenes = options.scenes.split(",")
    leads = [int(lead) for lead in options.lead.split(",")]
    asked = (options.seconds, options.people)
    rows = measure(options.out, scenes, options.seeds, *asked, leads, options.jobs)
    wanted = [row for row in rows if (row["seconds"], row["people"]) == asked]
    for line in report(wanted, scenes, leads):
        print(line)


if __name__ == "__main__":
    main()
