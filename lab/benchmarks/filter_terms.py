"""Worth of changes of the filter and the policy, by judges that share nothing with them.

    E3POSE_SHARED=... python lab/benchmarks/filter_terms.py 4de5ca09 --out terms.jsonl
    python lab/benchmarks/filter_terms.py "estimate/filter/compare: RATE = 0.1 => RATE = 0.0"
    python lab/benchmarks/filter_terms.py HEAD~3 --policy information --cases pizza,one-sided

Each argument is a version of the package beside the working tree: a commit, or a text of one module
and what stands in its place. It is compiled and measured in a process of its own; a run that was
stopped goes on.

Judges: a camera of pizza that took no part, each in turn (the first half, or with `--judge` the
second; median distance across its rays); with `--judge` also the labels of Shelf; the truth of
motion capture and scenes, before cameras that err by situation (`+`) or by score (`-`). Lead 4.
Cameras take turns, so that all versions select alike: one per slot, in short slots also a half, in
scenes also two. `--policy information` selects. `--rare` has what single terms are there for.

A cell is the change of the error in percent (more is worse in that version) with the standard error
over its replays, which are paired, and after it what else changed: people missed (m) and false
people (n), in percent of all people; changes of identity (c) per 100 people seconds; joints in the
stated 90 % radius (i), limbs that are wrong (w, `e3pose.evaluate.wrong_limbs`) or a fifth too long
or too short (l) and limbs of Shelf (PCP), in percent. Every judge counts m and n but Shelf, whose
labels leave people out, so n is not known. To a held-out camera a pose in its image that it detects
nobody at is false, in percent of poses: many are people whom it misses, so only the change tells,
as with w, which includes limbs that it has wrong itself. `false people` has one camera per slot at
30 and 60 slots per second, where a term can make people up and no error shows it.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose_lab.datasets import shared_folder

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("buffet+", "lab+", "round-table+", "crossing-", "two-rooms-", "one-sided-")
MADE_UP = (("ring", 20.0, 30.0), ("pillar", 20.0, 30.0), ("ring", 10.0, 60.0))
NOW = "as it is"
WARMUP, LEAD = 10, 4
SAME_M = 0.5
MOVED_PX, GUESSED_PX, IMAGE_PX = (3.3, 2.26), 60.0, 1032
# Changes from which a cell has them; a rare false person counts, so theirs is that of rounding.
TELLING = {
    "missed": 0.005, "nobody": 0.005, "changes": 0.5, "in 90": 1.5, "limbs": 0.3, "PCP": 0.3,
    "wrong": 0.05,
}  # fmt: skip
PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
HEAD, FEET = ("nose", "eye", "ear"), ("toe", "heel")


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
        parts: what the names of the joints have in them that count.
    """

    name: str
    recording: Any
    expected: Floats | None = None
    phases: int = 1
    judges: Any = None
    counts: tuple[float, ...] = (1.0,)
    parts: tuple[str, ...] = PARTS


def cases(shared: Path | None, seeds: Sequence[int], judging: bool) -> Iterator[Case]:
    """Yield what is measured, of the package as it is."""
    from detector_errors import simulated
    from e3pose.evaluate.faults import downsampled
    from e3pose.evaluate.held_out import turns
    from e3pose.recording import load_recording
    from e3pose.simulate import DetectorSettings, Guessing
    from e3pose_lab.datasets.shelf import import_shelf
    from predictor_in_the_loop import captured, seen

    if shared is not None:
        pizza = half(load_recording(shared / "data/pizza/recording"), judging)
        for fps, phases in ((30.0, 1), (12.5, 2), (6.0, 2)):
            counts = (0.5, 1.0) if fps == 30.0 else (1.0,)
            slower = downsampled(pizza, fps) if fps < pizza.fps else pizza
            for rest, by in turns(slower, ["each"])[1:]:
                yield Case(f"pizza {fps:g}", rest, None, phases, by, counts)
        if judging:
            yield Case("Shelf", import_shelf(shared / "data/shelf/shelf.npz"), None, 5)
        for name, joints_m in captured(shared):
            for slots in (200, 198):  # which draw other errors
                detector = DetectorSettings(guessing=Guessing())
                recording = seen(joints_m[::2][:slots], 15.0, detector)
                yield Case(f"{name}+", recording, truth_of(recording), 2)
    for scene in SCENES:
        for seed in seeds:
            recording = simulated(scene, seed, seconds=16.0, fps=12.5)
            yield Case(scene, recording, truth_of(recording), counts=(1.0, 2.0))
    for (scene, seconds, fps), seed in product(MADE_UP, seeds):
        recording = simulated(scene, seed, seconds=seconds, fps=fps)
        yield Case("false people", recording, truth_of(recording))


def rare_cases(shared: Path | None) -> Iterator[Case]:
    """Yield what single terms are there for."""
    from detector_errors import simulated
    from e3pose.evaluate.held_out import turns
    from e3pose.recording import load_recording
    from e3pose.simulate.feet import with_skeleton

    def case(name: str, recording: Any, *counts: float) -> Case:
        return Case(name, recording, truth_of(recording), counts=counts)

    if shared is not None:
        pizza = half(load_recording(shared / "data/pizza/recording"), second=False)
        for rest, by in turns(pizza, ["each"])[1:]:
            yield Case("pizza 30, all", rest, judges=by, counts=(4.0,))
            yield Case("pizza heads", rest, judges=by, parts=HEAD)
            yield Case("pizza feet", rest, judges=by, parts=FEET)
    for scene, seed in product(("ring-", "lab+"), (2001, 2002)):
        recording = simulated(scene, seed, seconds=12.0, fps=30)
        yield case(f"{scene} 30", recording, 2.0, float(len(recording.rig)))
    for scene in ("ring-", "pillar-", "round-table+", "one-sided-"):
        recording = simulated(scene, 2001, seconds=30.0, fps=12.5)
        yield case("moved 4 px", shifted(recording, np.array(MOVED_PX), 1), 1.0, 2.0)
        ankle = np.arange(len(recording.skeleton)) == recording.skeleton.index("left_ankle")
        guess_px = ankle[:, None] * np.array([GUESSED_PX, 0.0])
        yield case("guessed ankle", shifted(recording, guess_px), 1.0, 2.0)
    for scene in ("ring-", "pillar-", "round-table+", "crossing-"):
        recording = simulated(scene, 2001, seconds=16.0, fps=12.5)
        for name in ("movenet-multipose", "openpose"):
            yield case("other files", replace(recording, detector=name), 1.0, 2.0)
    scenes = ("ring-", "crossing-", "round-table+", "buffet+")
    for scene, seed in product(scenes, (2001, 2002)):
        recording = simulated(scene, seed, seconds=16.0, fps=12.5)
        yield replace(case("heads", recording, 1.0, 2.0), parts=HEAD)
        feet = with_skeleton(recording, "body25", seed)
        yield replace(case("feet", feet, 1.0, 2.0), parts=FEET)
    for share, scene, seed in product((0.06, 0.2), scenes, range(2001, 2005)):
        recording = simulated(scene, seed, {"swap": share}, seconds=6.0, fps=12.5)
        yield case(f"exchanged {share:.0%}", recording, 1.0, 2.0)
    for scene, seed in product(("one-sided-", "shaft-", "l-hall-"), range(2004, 2010)):
        yield case("one camera", simulated(scene, seed, seconds=16.0, fps=12.5), 1.0)
    blind = ("dying-cameras-", "l-hall-", "shaft-", "pillar-")
    for scene, seed in product(blind, (2001, 2002)):
        yield case("blind cameras", simulated(scene, seed, seconds=16.0, fps=12.5), 1.0, 2.0)


def shifted(recording: Any, by_px: Floats, num_cameras: int | None = None) -> Any:
    """Return a recording whose first cameras take joints to be elsewhere, in pixels of 1032."""
    moved = [
        replace(view, keypoints_px=view.keypoints_px + max(camera.image_size) / IMAGE_PX * by_px)
        for view, camera in zip(recording.views[:num_cameras], recording.rig.cameras, strict=False)
    ]
    return replace(recording, views=(*moved, *recording.views[len(moved) :]))


def truth_of(recording: Any) -> Floats:
    """Return `Case.expected` of a recording whose truth is known."""
    return np.asarray(recording.truth.joints_m)


def half(whole: Any, second: bool) -> Any:
    """Return one half of a recording, without truth."""
    from e3pose.recording import ViewSeries

    first, views = whole.num_slots // 2, []
    begin, end = (first, whole.num_slots) if second else (0, first)
    for series in whole.views:
        rows = slice(*np.searchsorted(series.slots, (begin, end)))
        people = slice(series.starts[rows.start], series.starts[rows.stop])
        starts = series.starts[rows.start : rows.stop + 1] - people.start
        views.append(
            ViewSeries(
                series.slots[rows] - begin, series.times_s[rows], starts,
                series.keypoints_px[people], series.scores[people],
            )
        )  # fmt: skip
    short = {"num_slots": end - begin, "truth": None, "scored_slots": None, "videos": {}}
    return replace(whole, views=tuple(views), **short)


def figures(case: Case, policy: str, cameras: float, phase: int) -> dict[str, float]:
    """Replay once; return sums over people, of which `report` makes the figures."""
    from e3pose.evaluate.held_out import judge
    from e3pose.evaluate.metrics import mean_errors_m
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import accuracy
    from e3pose.evaluate.wrong_limbs import wrong_by_truth
    from e3pose.model.uncertainty import distance_within_m

    names = [joint.lower() for joint in case.recording.skeleton.joints]
    use = [i for i, n in enumerate(names) if any(p in n for p in case.parts) and "mid" not in n]
    settings = ReplaySettings(
        pipeline="memory", policy=policy, num_selected=cameras,
        lead_slots=LEAD, warmup_slots=WARMUP, phase=phase, seed=phase,
    )  # fmt: skip
    records = list(replay(case.recording, settings))
    if case.judges is not None:
        said = judge(case.judges, records).mean
        off_mm: float | None = said.median_mm
        if case.parts != PARTS:
            of_joints = [said.joints[case.recording.skeleton.joints[i]].median_mm for i in use]
            off_mm = float(np.nanmean([np.nan if mm is None else mm for mm in of_joints]))
        missed, unseen = said.missed_percent or 0.0, said.unseen_percent or 0.0
        wrong = said.wrong_limbs_percent or 0.0
        return {"mm": off_mm or float("nan"), "wrong": wrong, "missed": missed, "nobody": unseen}
    if case.expected is None:
        found = accuracy(case.recording, records)
        pcp = found.pcp.actors["average"] if found.pcp else float("nan")
        missed = 100 * (1 - (found.recall_500mm or 0.0))
        wrong = found.wrong_limbs_percent or 0.0
        return {"mm": found.mpjpe_mm or float("nan"), "wrong": wrong, "PCP": pcp, "missed": missed}
    off_m: list[Floats] = []
    inside: list[Floats] = []
    odd: list[Floats] = []
    turned: list[Floats] = []
    ends = np.array(case.recording.skeleton.limbs).T
    there = met = shown = changes = 0
    who: dict[int, int] = {}
    for record in records:
        if record.slot < WARMUP + LEAD - 1:
            continue
        expected = case.expected[record.slot][:, use]
        people = np.flatnonzero(np.isfinite(expected).all(-1).sum(-1) >= len(use) // 2)
        there, shown = there + len(people), shown + len(record.people.joints_m)
        joints_m = record.people.joints_m[:, use]
        if not len(joints_m) or not len(people):
            continue
        apart = np.nan_to_num(mean_errors_m(joints_m, expected[people]), nan=9.0)
        for row, column in zip(*linear_sum_assignment(np.minimum(apart, SAME_M)), strict=True):
            if apart[row, column] < SAME_M:
                person, track = int(people[column]), int(record.people.track_ids[row])
                met, changes = met + 1, changes + (who.get(person, track) != track)
                who[person] = track
                off = np.linalg.norm(joints_m[row] - expected[person], axis=-1)
                known = np.isfinite(off)
                both = record.people.joints_m[row], case.expected[record.slot][person]
                turned.append(wrong_by_truth(*both, case.recording.skeleton.joints))
                shown_m, true_m = (np.linalg.norm(np.subtract(*p[ends]), axis=-1) for p in both)
                odd.append(np.abs(np.log(shown_m / true_m)) > np.log(1.2))
                off_m.append(off[known])
                radius = distance_within_m(record.people.covariance_m2[row][use], 0.9)
                inside.append((off <= radius)[known])
    seconds = there * case.recording.interval_s
    return {
        "mm": 1000 * float(np.concatenate(off_m).mean()) if off_m else float("nan"),
        "in 90": 100 * float(np.concatenate(inside).mean()) if inside else float("nan"),
        "limbs": 100 * float(np.concatenate(odd).mean()) if odd else float("nan"),
        "wrong": 100 * float(np.nanmean(np.concatenate(turned))) if turned else float("nan"),
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


def package(version: str, folder: Path) -> Path:
    """Return the folder of the package's source in a version."""
    if version == NOW:
        return ROOT / "src"  # whose kernels may be compiled
    source = folder / "src"
    shutil.rmtree(source, ignore_errors=True)
    if " => " not in version:
        words = ["git", "-C", str(ROOT), "archive", version, "src"]
        archive = subprocess.run(words, check=True, stdout=subprocess.PIPE).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            files.extractall(folder, filter="data")
        return source
    shutil.copytree(ROOT / "src", source)
    module, _, change = version.partition(": ")
    old, _, new = change.partition(" => ")
    path = source / "e3pose" / f"{module}.py"
    text = path.read_text()
    if text.count(old) != 1:
        raise SystemExit(f"{path.name} has {old!r} {text.count(old)} times, expected once")
    path.write_text(text.replace(old, new))
    return source


def run(version: str, made: Path, folder: Path, policy: str) -> dict[str, list[dict[str, float]]]:
    """Measure a version of the package, in a process of its own."""
    out = folder / "figures.json"
    paths = f"{package(version, folder)}{os.pathsep}{ROOT / 'lab' / 'benchmarks'}"
    words = [sys.executable, __file__, "--measure", str(made), str(out), "--policy", policy]
    subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": paths})
    return dict(json.loads(out.read_text()))


def report(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield a table in Markdown."""
    base = rows[0]["found"]
    yield f"| version | {' | '.join(base)} |"
    yield "|---" * (len(base) + 1) + "|"
    for row in rows:
        cells = [_cell(base[name], row["found"][name], row is rows[0]) for name in base]
        yield f"| {row['version']} | {' | '.join(cells)} |"


def _cell(base: Sequence[dict[str, float]], found: Sequence[dict[str, float]], first: bool) -> str:
    figures = [figure for figure in TELLING if figure in base[0]]
    if first:
        words = [f"{np.mean([row['mm'] for row in base]):.1f} mm"]
        means = {key: np.mean([row[key] for row in base]) for key in figures}
        return " ".join(words + [f"{_short(key)} {mean:.3g}" for key, mean in means.items()])
    words = [_spread([100 * (b["mm"] / a["mm"] - 1) for a, b in zip(base, found, strict=True)], 1)]
    for key in figures:
        changed = [b[key] - a[key] for a, b in zip(base, found, strict=True)]
        if abs(np.mean(changed)) >= TELLING[key]:
            words.append(f"{_short(key)} {_spread(changed, 2)}")
    return " ".join(words)


def _spread(changed: Sequence[float], digits: int) -> str:
    error = np.nanstd(changed, ddof=1) / len(changed) ** 0.5
    return f"{np.nanmean(changed):+.{digits}f} ± {error:.{digits}f}"


def _short(figure: str) -> str:
    return figure if figure == "PCP" else figure[0]


def main() -> None:
    """Measure what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("versions", nargs="*", help="commits, or MODULE: OLD => NEW")
    parser.add_argument("--measure", nargs=2, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cases", help="how columns begin, with commas; all if not given")
    parser.add_argument("--policy", default="round-robin", help="who selects")
    parser.add_argument("--cameras", help="per slot, with commas, in place of those of each case")
    parser.add_argument("--seeds", type=int, default=3, help="of each scene")
    parser.add_argument("--first-seed", type=int, default=2001)
    parser.add_argument("--rare", action="store_true", help="cases that single terms are there for")
    parser.add_argument("--judge", action="store_true", help="by what no constant was chosen on")
    parser.add_argument("--out", type=Path, default=Path("terms.jsonl"))
    options = parser.parse_args()
    if options.measure:
        made, out = options.measure
        measure(made, out, options.policy)
        return
    folder = options.out.with_suffix(".work").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "cases.pickle"
    if not made.exists():
        shared = shared_folder() if os.environ.get("E3POSE_SHARED") else None
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        names = tuple(options.cases.split(",")) if options.cases else ("",)
        every = rare_cases(shared) if options.rare else cases(shared, seeds, options.judge)
        chosen = [case for case in every if case.name.startswith(names)]
        if options.cameras:
            counts = tuple(map(float, options.cameras.split(",")))
            chosen = [replace(case, name=f"{case.name}, C = {c:g}", counts=(c,))
                      for case in chosen for c in counts]  # fmt: skip
        made.write_bytes(pickle.dumps(chosen))
    done = options.out.read_text().splitlines() if options.out.exists() else []
    rows = {row["version"]: row for row in map(json.loads, done)}
    for version in (NOW, *options.versions):
        if version not in rows:
            print(f"{version} ...", file=sys.stderr, flush=True)
            found = run(version, made, folder, options.policy)
            rows[version] = {"version": version, "found": found}
            with options.out.open("a") as file:
                file.write(json.dumps(rows[version]) + "\n")
    print("\n".join(report(list(rows.values()))))


if __name__ == "__main__":
    main()
