"""What each term of the filter is worth: switched off, one at a time.

    E3POSE_SHARED=... python lab/benchmarks/filter_terms.py --clip RECORDING --out terms.jsonl
    python lab/benchmarks/filter_terms.py --only "agility;shift"
    python lab/benchmarks/filter_terms.py --numbers --cases Shelf,CMU,two-rooms-,lab+

Every variant is a copy of the package with one rule out of force, compiled and measured in a
process of its own; a run that was stopped goes on. With `--numbers` every tuned number of the
filter is halved and doubled in place of that (those of a name together, counts rounded). Each
recording is replayed with one and two cameras of `information` and with all, lead 4. A cell is the
change of the mean error over these in percent (more is worse without the term), and after it what
else changed: people missed (m) and false people (n), in percent of all people; changes of identity
(c) per 100 people seconds; joints in the stated 90 % radius (i), in percent. Real recordings are
compared with the smoother over all cameras of the package as it is, others with the truth.
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
from collections.abc import Callable, Iterator, Sequence
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
SCENES = (("buffet+", 2001), ("lab+", 2002), ("round-table+", 2003), ("crossing-", 2004),
          ("two-rooms-", 2005), ("one-sided-", 2006))  # fmt: skip
GOALS = (("information", 1.0), ("information", 2.0), ("all", 0.0))
WARMUP, LEAD = 10, 4
SAME_M = 0.5
PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One recording.

    Attributes:
        name: of its column.
        recording: without truth where that is not known.
        expected: `(num_slots, num_people, num_joints, 3)` metres.
        phases: turns that cameras take.
    """

    name: str
    recording: Any
    expected: Floats
    phases: int = 1


def cases(shared: Path | None, clip: Path | None) -> Iterator[Case]:
    """Yield what is measured, of the package as it is."""
    from clip_error import references
    from detector_errors import simulated
    from e3pose.evaluate.faults import downsampled
    from e3pose.model.noises import detector_of, load_noise
    from e3pose.recording import load_recording
    from e3pose.recording.datasets.shelf import import_shelf
    from e3pose.simulate.detections import until
    from predictor_in_the_loop import captured, seen

    def real(name: str, whole: Any, seconds: float, fps: float, phases: int) -> Case:
        slots = min(whole.num_slots, round(seconds / whole.interval_s))
        views = tuple(until(series, slots) for series in whole.views)
        cut = replace(whole, num_slots=slots, views=views, truth=None)
        recording = downsampled(cut, fps) if fps < whole.fps else cut
        people = references(recording, load_noise(detector_of(recording)))
        expected = [[person.at(slot) for person in people] for slot in range(recording.num_slots)]
        return Case(name, recording, np.array(expected), phases)

    if shared is not None:
        pizza = load_recording(shared / "data/pizza/recording")
        yield real("pizza 30", pizza, 20.0, 30.0, 1)
        yield real("pizza 6", pizza, 31.0, 6.0, 2)
        yield real("Shelf", import_shelf(shared / "data/shelf/shelf.npz"), 24.0, 25.0, 1)
        for name, joints_m in captured(shared):
            recording = seen(joints_m[::2][:200], 15.0)
            yield Case(name, recording, truth_of(recording))
    if clip is not None:
        yield real("clip", load_recording(clip), 60.0, 60.0, 2)
    for scene, seed in SCENES:
        recording = simulated(scene, seed, seconds=16.0, fps=12.5)
        yield Case(scene, recording, truth_of(recording))


def truth_of(recording: Any) -> Floats:
    """Return `Case.expected` of a recording whose truth is known."""
    return np.asarray(recording.truth.joints_m)


def figures(case: Case, policy: str, cameras: float, phase: int) -> dict[str, float]:
    """Replay once; return sums over people, of which `report` makes the figures."""
    from e3pose.evaluate.metrics import mean_errors_m
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.model.uncertainty import distance_within_m

    names = [joint.lower() for joint in case.recording.skeleton.joints]
    use = [i for i, n in enumerate(names) if any(p in n for p in PARTS) and "mid" not in n]
    settings = ReplaySettings(
        pipeline="memory", policy=policy, num_selected=cameras or len(case.recording.rig),
        lead_slots=LEAD, warmup_slots=WARMUP, phase=phase, seed=phase,
    )  # fmt: skip
    off_m: list[Floats] = []
    inside: list[Floats] = []
    there = found = shown = changes = 0
    who: dict[int, int] = {}
    for record in replay(case.recording, settings):
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
                found, changes = found + 1, changes + (who.get(person, track) != track)
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
        "missed": 100 * (1 - found / max(there, 1)),
        "nobody": 100 * (shown - found) / max(there, 1),
        "changes": 100 * changes / max(seconds, 1e-9),
    }


def measure(made: Path, out: Path) -> None:
    """Write the figures of the package that is imported."""
    found: dict[str, list[dict[str, float]]] = {}
    for case in pickle.loads(made.read_bytes()):
        for phase in range(case.phases):
            for policy, cameras in GOALS:
                if policy == "all" and phase:
                    continue
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
    for module, old, new in TERMS[term]:
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


def run(term: str, made: Path, folder: Path) -> dict[str, list[dict[str, float]]]:
    """Measure the package without a term, in a process of its own."""
    out = folder / "figures.json"
    paths = f"{package(term, folder)}{os.pathsep}{ROOT / 'lab' / 'benchmarks'}"
    words = [sys.executable, __file__, "--measure", str(made), str(out)]
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
    def mean(rows: Sequence[dict[str, float]], figure: str) -> float:
        return float(np.mean([row[figure] for row in rows]))

    others: dict[str, Callable[[float], bool]] = {
        "missed": lambda by: abs(by) >= 0.3, "nobody": lambda by: abs(by) >= 0.3,
        "changes": lambda by: abs(by) >= 0.5, "in 90": lambda by: abs(by) >= 1.5,
    }  # fmt: skip
    if first:
        words = [f"{mean(base, 'mm'):.1f} mm"]
        return " ".join(words + [f"{key[0]} {mean(base, key):.1f}" for key in others])
    words = [f"{100 * (mean(found, 'mm') / mean(base, 'mm') - 1):+.1f}"]
    for key, telling in others.items():
        by = mean(found, key) - mean(base, key)
        if telling(by):
            words.append(f"{key[0]} {by:+.1f}")
    return " ".join(words)


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--measure", nargs=2, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--shared", type=Path, default=os.environ.get("E3POSE_SHARED") or None)
    parser.add_argument("--clip", type=Path, help="a recording of the demo's films")
    parser.add_argument("--only", help="terms, with semicolons")
    parser.add_argument("--numbers", action="store_true", help="every tuned number, half and twice")
    parser.add_argument("--cases", help="names of columns, with commas; all if not given")
    parser.add_argument("--out", type=Path, default=Path("terms.jsonl"))
    options = parser.parse_args()
    if options.measure:
        measure(*options.measure)
        return
    shared = Path(options.shared) if options.shared else None
    folder = options.out.with_suffix(".work").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "cases.pickle"
    if not made.exists():
        wanted = options.cases.split(",") if options.cases else None
        found = [c for c in cases(shared, options.clip) if wanted is None or c.name in wanted]
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
            rows.append({"term": term, "found": run(term, made, folder)})
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n".join(report(rows)))


if __name__ == "__main__":
    main()
