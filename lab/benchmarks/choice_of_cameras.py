"""Round robin against `information` and chance: real recordings first, simulated scenes after.

    python lab/benchmarks/choice_of_cameras.py --recording PIZZA,CLIP --scenes buffet --leads 1,4
    python lab/benchmarks/choice_of_cameras.py --recording RECORDING --seconds 15 --rates 30

Ten joints count: shoulders, elbows, wrists, hips and knees. The judges took no part: `held-out mm`
is the median distance across the rays of a camera that gave nothing, mean over the cameras of a
real recording, each in turn (`replay --hold-out each`); `MPJPE mm` is the mean distance from the
truth, with people matched one to one below half a metre, `found %` the share of them found and
`in 90 %` that of joints whose distance from the truth is within the stated 90 % radius. Cells are
round robin / `information` / random, with the standard deviation over seeds, which are
phases of the turns on real recordings; `gain %` is how much nearer `information`
is than round robin, paired by seed. `--cameras 1,40mm` has a target error beside a number; `awake`
is how many cameras were, `first` how often the first one was selected by `information`, over the
mean of the others. A scene with `+` has errors by situation, one with `-` errors by score alone;
`motion-1` and `motion-2` are Panoptic motion before simulated cameras. A rate above a recording's
own is the recording's. `--by-lead` prints a column per lead instead. Every line of `--out` is one
replay; a run that was stopped goes on, and several files, with commas, are read as one: of two
lines of the same replay the later counts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from detector_errors import simulated
from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.held_out import COMPARED, judge, turns
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.uncertainty import distance_within_m
from e3pose.recording import Recording, load_recording
from e3pose.simulate.detections import until
from e3pose_lab.datasets import shared_folder
from predictor_in_the_loop import captured, seen

Row = dict[str, Any]

POLICIES = ("round-robin", "information", "random")
SCENES = "round-table,buffet,reception,operating-room,lab"
MOTION = "motion-"
SAME_M = 0.5
WARMUP = 10  # slots with all cameras, left out
HELD = "held_mm"  # needs as many replays more as there are cameras, of recordings without truth


def settings_of(policy: str, cameras: float, lead: int, seed: int) -> ReplaySettings:
    """Return how to replay with a number of cameras per slot."""
    return ReplaySettings(
        pipeline="memory", policy=policy, lead_slots=lead, seed=seed, phase=seed,
        num_selected=cameras, warmup_slots=WARMUP,
    )  # fmt: skip


def figures(
    recording: Recording, policy: str, goal: str, lead: int, seed: int, hold_out: bool = True
) -> Row:
    """Replay once, and once more without each camera where `hold_out`; return the figures."""
    columns = [recording.skeleton.index(joint) for joint in COMPARED]
    if goal.endswith("mm"):
        settings = settings_of(policy, len(recording.rig), lead, seed)
        settings = replace(settings, target_error_m=float(goal.removesuffix("mm")) / 1000)
    else:
        settings = settings_of(policy, float(goal), lead, seed)
    apart: list[Floats] = []
    inside: list[NDArray[np.bool_]] = []
    found = there = slots = 0
    looks = np.zeros(len(recording.rig))
    for record in replay(recording, settings):
        if record.slot < WARMUP + lead - 1:
            continue
        slots, looks = slots + 1, looks + record.selected
        joints_m, covariance_m2 = (
            record.people.joints_m[:, columns],
            record.people.covariance_m2[:, columns],
        )
        expected_m = truth(recording, record.slot)[:, columns]
        pairs = matched(joints_m, expected_m)
        for mine, theirs in pairs:
            distance = np.linalg.norm(joints_m[mine] - expected_m[theirs], axis=-1)
            known = np.isfinite(distance)
            apart.append(distance[known])
            inside.append(distance[known] <= distance_within_m(covariance_m2[mine][known], 0.9))
        found, there = found + len(pairs), there + len(expected_m)
    return {
        "awake": looks.sum() / max(slots, 1),
        "first": looks[0] / max(looks[1:].mean(), 1e-9),
        **({HELD: held_out_mm(recording, settings)} if hold_out else {}),
        "mpjpe_mm": mean_mm(apart),
        "found": found / there if there else None,
        "inside_truth": float(np.concatenate(inside).mean()) if inside else None,
    }


def held_out_mm(recording: Recording, settings: ReplaySettings) -> float | None:
    """Return the mean over cameras, each held out in turn; None with truth, or too few cameras."""
    if recording.truth is not None:
        return None
    if (settings.num_selected or 0) >= len(recording.rig):
        settings = replace(settings, num_selected=None, policy="all")
    try:
        judged = turns(recording, ["each"])[1:]
    except InputError:
        return None
    found = [judge(by, list(replay(rest, settings))).mean.median_mm for rest, by in judged if by]
    known = [mm for mm in found if mm is not None]
    return float(np.mean(known)) if known else None


def truth(recording: Recording, slot: int) -> Floats:
    """Return the true places of a slot, nobody where they are not known."""
    if recording.truth is None:
        return np.empty((0, len(recording.skeleton), 3))
    return np.asarray(recording.truth.joints_m[slot])


def mean_mm(distances_m: Sequence[Floats]) -> float | None:
    """Return the mean of all distances in millimetres; None without any."""
    return 1000 * float(np.concatenate(distances_m).mean()) if distances_m else None


def matched(joints_m: Floats, expected_m: Floats) -> list[tuple[int, int]]:
    """Match people to the truth, one to one: pairs of rows less than half a metre apart."""
    if not len(joints_m) or not len(expected_m):
        return []
    apart = np.nan_to_num(mean_errors_m(joints_m, expected_m), nan=np.inf)
    rows, columns = linear_sum_assignment(np.minimum(apart, 1e3))
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [pair for pair in pairs if apart[pair] < SAME_M]


def measure(options: argparse.Namespace, out: Path) -> Iterator[Row]:
    """Yield the rows that are not in the file yet."""
    hold_out = options.by_lead in (None, HELD)
    have = {key_of(row) for row in read([out]) if HELD in row or not hold_out}
    runs = [
        (policy, goal)
        for goal in options.cameras.split(",")
        for policy in options.policies.split(",")
        if policy == "information" or not goal.endswith("mm")
    ]
    leads = [int(lead) for lead in options.leads.split(",")]
    for place, fps, seed in product(
        places(options),
        [float(rate) for rate in options.rates.split(",")],
        [int(seed) for seed in options.seeds.split(",")],
    ):
        todo = [
            (*run, lead)
            for lead, run in product(leads, runs)
            if (place, fps, seed, *run, lead) not in have
        ]
        if not todo:
            continue
        real = recorded(place) or place.startswith(MOTION)
        recording = made(place, fps, options.seconds, 0 if real else seed)
        for policy, goal, lead in todo:
            if recording.num_slots < 2 * (WARMUP + lead):
                continue
            yield {
                "place": place, "fps": fps, "seed": seed, "policy": policy, "goal": goal,
                "lead": lead, **figures(recording, policy, goal, lead, seed % 1000, hold_out),
            }  # fmt: skip


def key_of(row: Row) -> tuple[Any, ...]:
    """Return the key of a replay: its place, rate, seed, policy, goal and lead."""
    return tuple(row[name] for name in ("place", "fps", "seed", "policy", "goal", "lead"))


def places(options: argparse.Namespace) -> list[str]:
    """Return real recordings, then scenes."""
    real = options.recording.split(",") if options.recording else []
    scenes = options.scenes or ("" if real else SCENES)
    return real + scenes.split(",") * bool(scenes)


def recorded(place: str) -> bool:
    """Return whether it is the folder of a recording; there are folders named like scenes."""
    return (Path(place) / "recording.toml").is_file()


def made(place: str, fps: float, seconds: float, seed: int) -> Recording:
    """Return the recording: simulated, or the first seconds of a real one."""
    if place.startswith(MOTION):
        motions = [m for kind, m in captured(shared_folder()) if kind == "Panoptic"]
        return downsampled(seen(motions[int(place.removeprefix(MOTION)) - 1], 30.0), min(fps, 30.0))
    if not recorded(place):
        return simulated(place, seed, seconds=seconds, fps=fps)
    whole = load_recording(Path(place))
    slots = min(whole.num_slots, round(seconds / whole.interval_s))
    views = tuple(until(series, slots) for series in whole.views)
    recording = replace(whole, num_slots=slots, views=views, truth=None)
    return downsampled(recording, min(fps, whole.fps))


def read(files: Sequence[Path]) -> list[Row]:
    """Read what was measured before; of two lines of the same replay the later counts."""
    lines = [line for file in files if file.exists() for line in file.read_text().splitlines()]
    return list({key_of(row): row for row in map(json.loads, lines)}.values())


def report(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table in Markdown, a line per place, rate, lead and goal."""
    columns = (
        "place | slots/s | lead | goal | seeds | awake | first | held-out mm | gain % | MPJPE mm "
        "| gain % | found % | in 90 %"
    )
    yield f"| {columns} |"
    yield "|---" * len(columns.split("|")) + "|"
    for place in dict.fromkeys(row["place"] for row in rows):
        keys = {(r["fps"], r["lead"], r["goal"]) for r in rows if r["place"] == place}
        for key in sorted(keys):
            mine = [
                r for r in rows if (r["place"], r["fps"], r["lead"], r["goal"]) == (place, *key)
            ]
            own = [row for row in mine if row["policy"] == "information"]
            cells = [
                Path(place).name, f"{key[0]:g}", str(key[1]), key[2],
                str(len({row["seed"] for row in mine})),
                *(_mean(own, "information", name, 1.0, 2) for name in ("awake", "first")),
                _all(mine, "held_mm"), _gain(mine, "held_mm"),
                _all(mine, "mpjpe_mm"), _gain(mine, "mpjpe_mm"),
                _all(mine, "found", 100.0), _all(mine, "inside_truth", 100.0),
            ]  # fmt: skip
            yield f"| {' | '.join(cells)} |"


def by_lead(rows: Sequence[Row], field: str) -> Iterator[str]:
    """Yield a table in Markdown of one figure, a line per place, goal and rate."""
    leads = sorted({row["lead"] for row in rows})
    yield f"| recording | C | slots/s | {' | '.join(f'lead {lead}' for lead in leads)} |"
    yield "|---" * (3 + len(leads)) + "|"
    for place in dict.fromkeys(row["place"] for row in rows):
        own = [row for row in rows if row["place"] == place]
        for goal, fps in sorted({(row["goal"], row["fps"]) for row in own}):
            cells = []
            for lead in leads:
                mine = [r for r in own if (r["goal"], r["fps"], r["lead"]) == (goal, fps, lead)]
                cells.append(f"{_all(mine, field)} ({_gain(mine, field)} %)" if mine else "")
            yield f"| {Path(place).name} | {goal} | {fps:g} | {' | '.join(cells)} |"


def _all(rows: Sequence[Row], field: str, factor: float = 1.0) -> str:
    return " / ".join(_mean(rows, policy, field, factor) for policy in POLICIES)


def _mean(rows: Sequence[Row], policy: str, field: str, factor: float, digits: int = 1) -> str:
    mine = [row.get(field) for row in rows if row["policy"] == policy]
    values = [value for value in mine if value is not None]
    if not values:
        return "-"
    spread = f" ± {factor * np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{factor * np.mean(values):.{digits}f}{spread}"


def _gain(rows: Sequence[Row], field: str) -> str:
    """Return by how much `information` is nearer than round robin, and its spread over seeds."""
    off = {(row["policy"], row["seed"]): row[field] for row in rows if row.get(field)}
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
    parser.add_argument("--by-lead", help="print one by lead: held_mm or mpjpe_mm")
    parser.add_argument("--out", default="choice.jsonl", help="the last is written")
    options = parser.parse_args()
    files = [Path(name) for name in options.out.split(",")]
    with files[-1].open("a") as file:
        for row in measure(options, files[-1]):
            file.write(json.dumps(row) + "\n")
            file.flush()
    rows = read(files)
    for line in by_lead(rows, options.by_lead) if options.by_lead else report(rows):
        print(line)


if __name__ == "__main__":
    main()
