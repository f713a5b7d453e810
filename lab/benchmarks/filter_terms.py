"""What each term of the filter is worth: switched off, one at a time.

    E3POSE_SHARED=... python lab/benchmarks/filter_terms.py --clip RECORDING --out terms.jsonl
    python lab/benchmarks/filter_terms.py --only "agility;shift"
    python lab/benchmarks/filter_terms.py --numbers --cases Shelf,CMU,two-rooms-,lab+

Every variant is a copy of the package with one rule out of force, or several (`"agility & stays"`),
compiled and measured in a process of its own; a run that was stopped goes on. With `--numbers`
every tuned number of the filter is halved and doubled in place of that (those of a name together,
counts rounded).

Independent judges come first: a camera of pizza that took no part, each in turn (second half at 30
slots per second, all of it at 6; median distance across its rays); the labels of Shelf; the truth
of motion capture and scenes, before cameras that err by situation (`+`) or by score (`-`). Columns
with `*` are distances from a smoother over the same keypoints, by the package as it is: it shares
their errors, and decides nothing. Lead 4. Cameras take turns, so that all variants select alike:
one per slot, in short slots also a half, in scenes also two. `--policy information` selects.

A cell is the change of the error in percent (more is worse without the term) with the standard
error over its replays, which are paired, and after it what else changed: people missed (m) and
false people (n), in percent of all people; changes of identity (c) per 100 people seconds; joints
in the stated 90 % radius (i) and limbs of Shelf (PCP), in percent.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
FILTER = "estimate/filter"
OFF = "1e9"
# Name, and what stands in place of what: a module, and the whole of a constant or other text.
TERMS: dict[str, tuple[tuple[str, str, str], ...]] = {
    "as it is": (),
    "agility": (("agility", "RATE", "0.0"),),
    "biases": (("bias", "MOST_LEARNED", "1e-9"),),
    "quick repetition": (("bias", "REPEATED", "0.0"),),
    "worth of a look again": (("bias", "UNLEARNED", "0.0"),),
    "detection map": (("blindness", "PRIOR_VIEWS", OFF),),
    "inflation by person": (("covariance_inflation", "PRIOR_M", OFF),),
    "leaving at all": (("shown", "LEAVES_HZ", "0.0"),),
    "failed pairs": (("failed_pairs", "SEVERAL", OFF),),
    "learned noise": (
        ("learned_noise", "MOST", "1.0 + 1e-9"),
        ("learned_noise", "STEEPEST", "1.0 + 1e-9"),
    ),
    "noise by score": (("learned_noise", "STEEPEST", "1.0 + 1e-9"),),
    "noise by camera": (("learned_noise", "ALIKE", OFF),),
    "noise with a memory": (("outliers", "MEMORY", OFF),),
    "caution": (("learned_noise", "CAUTION", "1.0"),),
    "shift": (("learned_shift", "MOST", "0.0"),),
    "least shift": (("learned_shift", "LEAST", "0.0"),),
    "joint limit": (("associate", "JOINT_LIMIT", OFF),),
    "walk between views": (("births", "WALK_MPS", "0.0"),),
    "score to start": (("births", "SHARED_SCORE", "0.05"),),
    "rate beyond 25": (("blindness", "FASTEST_S", "1e-9"),),
    "unseen end": (
        (
            "existence",
            "        seen |= unmeasured_s[joint] <= PROOF_S",
            "        seen = True",
        ),
    ),
    "two in a chest": (("existence", "CHEST_M", "0.0"),),
    "wide bodies": (("existence", "MOST_WIDE_M", OFF),),
    "delivered": (("existence", "DELIVERED_RATE", "0.0"),),
    "delivered forgotten": (("existence", "DELIVERED_LASTS_S", OFF),),
    "confirmation by hits": (("existence", "CONFIRM_CAMERAS, CONFIRM_HITS", "3, 3"),),
    "lone view": (("lone_view", "    if shown != 1:", "    if True:"),),
    "size of a lone view": (("lone_view", "SIZE_SHARE", "0.0"),),
    "known slots": (("motion", "LEAST_KNOWN_SLOTS", "1"),),
    "proportions": (
        ("bones", "    kinds = ", "    kinds = np.full(len(pairs), -1) if pairs else "),
    ),
    "odd limbs": (("proportions", "1.0 / (1.0 + off * ROBUST)", "1.0"),),
    "contradicted limbs": (
        (
            "proportions",
            "        if squares > MEASURED_SIGMAS**2 * _v",
            "        if squares > 1e9 * _v",
        ),
    ),
    "stays": (("repeated_errors", "STAYS", "0.0"),),
    "shown spread": (("shown", "SHOWN_SPREAD_M", OFF),),
    "sides": (("sides", "ARMS_ODDS, LEGS_ODDS", f"{OFF}, {OFF}"),),
    "turned tracks": (("sides", "            if share > 0.5:", "            if False:"),),
    "wild keypoints": (("outliers", "OUTLIER_SIGMAS", OFF),),
    "measured": (("outliers", "MEASURED_SIGMAS", OFF),),
    "iterations": (("update", "ITERATIONS", "1"),),
    "usual feet": (("update", "USUAL_SLACK_M", OFF),),
    "learned bones": (("update", "BONE_KNOWN_M", "0.0"),),
    "steering": (("steer", "GAIN", "0.0"),),
    "one habit of feet": (
        ("tree", "TOE", "Habit(8.2, 0.2, usual_m=0.2)"),
        ("tree", "SMALL_TOE", "Habit(8.2, 0.2, usual_m=0.09)"),
        ("tree", "HEEL", "Habit(8.2, 0.2, usual_m=0.08)"),
    ),
    "waiting views": (("state", "WAIT_VIEWS", "0.0"),),
}
FACTORS = {"half": 0.5, "twice": 2.0}
SCENES = ("buffet+", "lab+", "round-table+", "crossing-", "two-rooms-", "one-sided-")
SHARED = "*"  # after the name of a column that shares keypoints with the estimates
WARMUP, LEAD = 10, 4
SAME_M = 0.5
PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One recording.

    Attributes:
        name: of its column.
        recording: without truth where that is not known.
        expected: `(num_slots, num_people, num_joints, 3)` metres; None with another judge.
        phases: turns that cameras take.
        judges: cameras that took no part, if they judge.
        counts: of cameras per slot.
    """

    name: str
    recording: Any
    expected: Floats | None = None
    phases: int = 1
    judges: Any = None
    counts: tuple[float, ...] = (1.0,)


def cases(shared: Path | None, clip: Path | None, seeds: int) -> Iterator[Case]:
    """Yield what is measured, of the package as it is; independent judges first."""
    from clip_error import references
    from detector_errors import simulated
    from e3pose.evaluate.faults import downsampled
    from e3pose.evaluate.held_out import turns
    from e3pose.model.noises import detector_of, load_noise
    from e3pose.recording import ViewSeries, load_recording
    from e3pose.simulate import DetectorSettings, Guessing
    from e3pose.simulate.detections import until
    from e3pose_lab.datasets.shelf import import_shelf
    from predictor_in_the_loop import captured, seen

    def start(whole: Any, seconds: float, fps: float) -> Any:
        slots = min(whole.num_slots, round(seconds / whole.interval_s))
        views = tuple(until(series, slots) for series in whole.views)
        cut = replace(whole, num_slots=slots, views=views, truth=None, scored_slots=None)
        return downsampled(cut, fps) if fps < whole.fps else cut

    def second_half(whole: Any) -> Any:
        first, views = whole.num_slots // 2, []
        for series in whole.views:
            row = int(np.searchsorted(series.slots, first))
            person = series.starts[row]
            views.append(
                ViewSeries(
                    series.slots[row:] - first, series.times_s[row:], series.starts[row:] - person,
                    series.keypoints_px[person:], series.scores[person:],
                )
            )  # fmt: skip
        return replace(whole, num_slots=whole.num_slots - first, views=tuple(views), videos={})

    def smoothed(name: str, recording: Any, phases: int) -> Case:
        people = references(recording, load_noise(detector_of(recording)))
        expected = [[person.at(slot) for person in people] for slot in range(recording.num_slots)]
        return Case(name + SHARED, recording, np.array(expected), phases)

    if shared is not None:
        pizza = load_recording(shared / "data/pizza/recording")
        shelf = import_shelf(shared / "data/shelf/shelf.npz")
        for rest, by in turns(second_half(pizza), ["each"])[1:]:
            yield Case("pizza 30", rest, judges=by, counts=(0.5, 1.0))
        for rest, by in turns(downsampled(pizza, 6.0), ["each"])[1:]:
            yield Case("pizza 6", rest, judges=by)
        yield Case("Shelf", shelf, None, 5)
        for name, joints_m in captured(shared):
            recording = seen(joints_m[::2][:200], 15.0, DetectorSettings(guessing=Guessing()))
            yield Case(f"{name}+", recording, truth_of(recording))
    for scene in SCENES:
        for seed in range(2001, 2001 + seeds):
            recording = simulated(scene, seed, seconds=16.0, fps=12.5)
            yield Case(scene, recording, truth_of(recording), counts=(1.0, 2.0))
    if shared is not None:
        yield smoothed("pizza 30", start(pizza, 20.0, 30.0), 1)
        yield smoothed("pizza 6", start(pizza, 31.0, 6.0), 2)
        yield smoothed("Shelf", start(shelf, 24.0, 25.0), 1)
    if clip is not None:
        yield smoothed("clip", start(load_recording(clip), 60.0, 60.0), 2)


def truth_of(recording: Any) -> Floats:
    """Return `Case.expected` of a recording whose truth is known."""
    return np.asarray(recording.truth.joints_m)


def figures(case: Case, policy: str, cameras: float, phase: int) -> dict[str, float]:
    """Replay once; return sums over people, of which `report` makes the figures."""
    from e3pose.evaluate.held_out import judge
    from e3pose.evaluate.metrics import mean_errors_m
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import accuracy
    from e3pose.model.uncertainty import distance_within_m

    names = [joint.lower() for joint in case.recording.skeleton.joints]
    use = [i for i, n in enumerate(names) if any(p in n for p in PARTS) and "mid" not in n]
    settings = ReplaySettings(
        pipeline="memory", policy=policy, num_selected=cameras,
        lead_slots=LEAD, warmup_slots=WARMUP, phase=phase, seed=phase,
    )  # fmt: skip
    records = list(replay(case.recording, settings))
    if case.judges is not None:
        said = judge(case.judges, records).mean
        return {"mm": said.median_mm or float("nan"), "missed": said.missed_percent or 0.0}
    if case.expected is None:
        found = accuracy(case.recording, records)
        pcp = found.pcp.actors["average"] if found.pcp else float("nan")
        return {"mm": found.mpjpe_mm or float("nan"), "PCP": pcp}
    off_m: list[Floats] = []
    inside: list[Floats] = []
    there = met = shown = changes = 0
    who: dict[int, int] = {}
    for record in records:
        if record.slot < WARMUP + LEAD - 1:
            continue
        expected = case.expected[record.slot][:, use]
        people = np.flatnonzero(np.isfinite(expected).all(-1).sum(-1) >= len(use) // 2)
        there, shown = there + len(people), shown + len(record.poses.joints_m)
        joints_m = record.poses.joints_m[:, use]
        if not len(joints_m) or not len(people):
            continue
        apart = np.nan_to_num(mean_errors_m(joints_m, expected[people]), nan=9.0)
        for row, column in zip(*linear_sum_assignment(np.minimum(apart, SAME_M)), strict=True):
            if apart[row, column] < SAME_M:
                person, track = int(people[column]), int(record.track_ids[row])
                met, changes = met + 1, changes + (who.get(person, track) != track)
                who[person] = track
                off = np.linalg.norm(joints_m[row] - expected[person], axis=-1)
                known = np.isfinite(off)
                off_m.append(off[known])
                radius = distance_within_m(record.covariance_m2[row][use], 0.9)
                inside.append((off <= radius)[known])
    seconds = there * case.recording.interval_s
    return {
        "mm": 1000 * float(np.concatenate(off_m).mean()) if off_m else float("nan"),
        "in 90": 100 * float(np.concatenate(inside).mean()) if inside else float("nan"),
        "missed": 100 * (1 - met / max(there, 1)),
        "nobody": 100 * (shown - met) / max(there, 1),
        "changes": 100 * changes / max(seconds, 1e-9),
    }


def measure(made: Path, out: Path, policy: str) -> None:
    """Write the figures of the package that is imported."""
    found: dict[str, list[dict[str, float]]] = {}
    for case in pickle.loads(made.read_bytes()):
        for phase in range(case.phases):
            for cameras in case.counts:
                row = figures(case, policy, cameras, phase)
                found.setdefault(case.name, []).append(row)
    out.write_text(json.dumps(found))


def package(term: str, folder: Path) -> Path:
    """Return the folder of a copy of the package's source in which a term is off."""
    source = folder / "src"
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(ROOT / "src", source)
    if term.split()[0] in FACTORS:
        scale(source / "e3pose" / FILTER, term)
        return source
    for module, old, new in [change for name in term.split(" & ") for change in TERMS[name]]:
        path = source / "e3pose" / FILTER / f"{module}.py"
        text = path.read_text()
        if not re.fullmatch(r"[A-Z_, ]+", old):
            changed, count = text.replace(old, new), text.count(old)
        else:
            changed, count = re.subn(rf"(?m)^{re.escape(old)} = [^#\n]*", f"{old} = {new}  ", text)
        if count != 1:
            raise SystemExit(f"{term}: {path.name} has {old!r} {count} times, expected once")
        path.write_text(changed)
    return source


def marked() -> Iterator[tuple[str, ast.Assign]]:
    """Yield the tuned constants of the filter: the module, and what assigns them."""
    for path in sorted((ROOT / "src/e3pose" / FILTER).glob("*.py")):
        lines = path.read_text().splitlines()
        for node in ast.parse("\n".join(lines)).body:
            above = node.lineno - 2
            while above >= 0 and lines[above].startswith("#   "):
                above -= 1
            if isinstance(node, ast.Assign) and lines[above].startswith("# tuned: "):
                yield path.stem, node


def scale(folder: Path, term: str) -> None:
    """Multiply the numbers of a constant in a copy of the filter; counts stay whole."""
    factor = FACTORS[term.split()[0]]
    for module, node in marked():
        if term.partition(" ")[2] != f"{module}.{ast.unparse(node.targets[0])}":
            continue
        path = folder / f"{module}.py"
        lines = path.read_text().splitlines()
        for number in ast.walk(node.value):
            if isinstance(number, ast.Constant):
                value: Any = number.value
                if type(value) is int:
                    number.value = max(1, round(value * factor))
                elif type(value) is float:
                    number.value = value * factor
        lines[node.lineno - 1 : node.end_lineno] = [ast.unparse(node)]
        path.write_text("\n".join(lines) + "\n")
        return
    raise SystemExit(f"{term}: no tuned number of the filter has that name")


def run(term: str, made: Path, folder: Path, policy: str) -> dict[str, list[dict[str, float]]]:
    """Measure the package without a term, in a process of its own."""
    out = folder / "figures.json"
    paths = f"{package(term, folder)}{os.pathsep}{ROOT / 'lab' / 'benchmarks'}"
    words = [sys.executable, __file__, "--measure", str(made), str(out), "--policy", policy]
    subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": paths})
    return dict(json.loads(out.read_text()))


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield a table in Markdown."""
    base = rows[0]["found"]
    yield f"| without | {' | '.join(base)} |"
    yield "|---" * (len(base) + 1) + "|"
    for row in rows:
        cells = [_cell(base[name], row["found"][name], row is rows[0]) for name in base]
        yield f"| {row['term']} | {' | '.join(cells)} |"


def _cell(base: Sequence[dict[str, float]], found: Sequence[dict[str, float]], first: bool) -> str:
    telling = {"missed": 0.3, "nobody": 0.3, "changes": 0.5, "in 90": 1.5, "PCP": 0.3}
    figures = [figure for figure in telling if figure in base[0]]
    if first:
        words = [f"{np.mean([row['mm'] for row in base]):.1f} mm"]
        means = {key: np.mean([row[key] for row in base]) for key in figures}
        return " ".join(words + [f"{_short(key)} {mean:.1f}" for key, mean in means.items()])
    by = np.array([100 * (b["mm"] / a["mm"] - 1) for a, b in zip(base, found, strict=True)])
    words = [f"{np.nanmean(by):+.1f} ± {np.nanstd(by, ddof=1) / len(by) ** 0.5:.1f}"]
    for key in figures:
        changed = np.mean([b[key] - a[key] for a, b in zip(base, found, strict=True)])
        if abs(changed) >= telling[key]:
            words.append(f"{_short(key)} {changed:+.1f}")
    return " ".join(words)


def _short(figure: str) -> str:
    return figure if figure == "PCP" else figure[0]


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--measure", nargs=2, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--shared", type=Path, default=os.environ.get("E3POSE_SHARED") or None)
    parser.add_argument("--clip", type=Path, help="a recording of the demo's films")
    parser.add_argument("--only", help="terms, with semicolons")
    parser.add_argument("--numbers", action="store_true", help="every tuned number, half and twice")
    parser.add_argument("--cases", help="names of columns, with commas; all if not given")
    parser.add_argument("--policy", default="round-robin", help="who selects")
    parser.add_argument("--seeds", type=int, default=1, help="of each scene")
    parser.add_argument("--out", type=Path, default=Path("terms.jsonl"))
    options = parser.parse_args()
    if options.measure:
        cases_file, figures_file = options.measure
        measure(cases_file, figures_file, options.policy)
        return
    shared = Path(options.shared) if options.shared else None
    folder = options.out.with_suffix(".work").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "cases.pickle"
    if not made.exists():
        wanted = options.cases.split(",") if options.cases else None
        found = [
            c
            for c in cases(shared, options.clip, options.seeds)
            if wanted is None or c.name in wanted
        ]
        made.write_bytes(pickle.dumps(found))
    done = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in done]
    have = {row["term"] for row in rows}
    named = [f"{module}.{ast.unparse(node.targets[0])}" for module, node in marked()]
    numbers = [f"{word} {name}" for name in named for word in FACTORS]
    every = numbers if options.numbers else TERMS
    terms = ["as it is", *(options.only.split(";") if options.only else every)]
    for term in dict.fromkeys(terms):
        if term not in have:
            print(f"{term} ...", file=sys.stderr, flush=True)
            rows.append({"term": term, "found": run(term, made, folder, options.policy)})
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(report(rows)))


if __name__ == "__main__":
    main()
