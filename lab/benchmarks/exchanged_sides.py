"""How often detectors exchange left and right, and what that costs: sides as given, and put right.

    E3POSE_SHARED=... python lab/benchmarks/exchanged_sides.py rates --clip CLIP
    E3POSE_SHARED=... python lab/benchmarks/exchanged_sides.py costs --clip CLIP --out sides.jsonl
    python lab/benchmarks/exchanged_sides.py identities --out identities.jsonl

A view is compared with the smoother over all others (`e3pose_lab.noise.residuals`), in simulation
with the truth. Arms (shoulders, elbows, wrists) or legs are exchanged if their keypoints lie nearer
to the joints of the other side by `CLEAR_M` in the mean, each joint counting to `CAP_M` at most.

`costs` replays with sides as given and put right (`right`): real detections by the smoother over
all cameras, which knows what no filter can know; simulated ones by another run of the simulator
without exchanges, all else alike. `no guesses` is without limbs on the other side's as well: real
ones are left out, simulated ones not made. `identities` scores scenes of people who pass each
other. Versions are those of `filter_terms.py`, which also judges.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose_lab.datasets import shared_folder
from filter_terms import LEAD, NOW, ROOT, WARMUP, Case, half, package, run, truth_of

Floats = NDArray[np.float64]

CLEAR_M, CAP_M, GROSS_M = 0.05, 0.3, 0.1
LEAST_KEYPOINTS = 3  # of a group, of its six
GROUPS = {"arms": (5, 6, 7, 8, 9, 10), "legs": (11, 12, 13, 14, 15, 16)}  # of COCO-17
MIRROR = np.array([0, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15])
HANGING = {
    "arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle", "toe", "heel"),
}  # fmt: skip
ENDS = ("elbow", "wrist", "knee", "ankle")
WITHOUT = "estimate/filter/sides: return found => return 0 * found"
OTHER = {"left": "right", "right": "left"}
SCENES = ("buffet+", "lab+", "round-table+", "crossing-", "two-rooms-")
SIGHTS = ("ahead", "aside", "behind")


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One person before one camera.

    Attributes:
        slots: `(num_slots,)`.
        given_m: `(num_slots, 17)` keypoints from their joints, across the ray, NaN if unknown.
        other_m: `(num_slots, 17)` from the joints of the other side.
        scores: `(num_slots, 17)`.
        keypoints_px: `(num_slots, 17, 2)` undistorted, by which a detection is known again.
        sight: `(num_slots,)` index in `SIGHTS`.
        camera: number.
    """

    slots: NDArray[np.int64]
    given_m: Floats
    other_m: Floats
    scores: Floats
    keypoints_px: Floats
    sight: NDArray[np.int64]
    camera: int

    def exchanged(self, group: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return `(num_slots,)` where a group is exchanged, and where this is known."""
        joints = list(GROUPS[group])
        given, other = (np.minimum(d[:, joints], CAP_M) for d in (self.given_m, self.other_m))
        known = np.isfinite(given) & np.isfinite(other)
        enough = known.sum(axis=1) >= LEAST_KEYPOINTS
        gain = np.where(known, given - other, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        return enough & (gain > CLEAR_M), enough

    @property
    def on_other(self) -> NDArray[np.bool_]:
        """`(num_slots, 17)` limbs' keypoints on the joint of the other side, in no exchange."""
        with np.errstate(invalid="ignore"):
            found = (self.given_m > GROSS_M) & (self.other_m < self.given_m / 2)
        for joint, name in enumerate(coco_joints()):
            group = "arms" if joint in GROUPS["arms"] else "legs"
            found[:, joint] &= name.endswith(ENDS) & ~self.exchanged(group)[0]
        return np.asarray(found)

    def known_again(self, series: Any, camera: Any, columns: list[int]) -> list[tuple[int, int]]:
        """Return each of its slots with the row of its detection in the camera's series."""
        found = []
        for index in np.flatnonzero(self.scores.any(axis=1)).tolist():
            frame = int(np.searchsorted(series.slots, self.slots[index]))
            rows = np.arange(series.starts[frame], series.starts[frame + 1])
            pixels = camera.undistort(series.keypoints_px[rows])[:, columns]
            for row, one in zip(rows.tolist(), pixels, strict=True):
                if np.array_equal(one, self.keypoints_px[index], equal_nan=True):
                    found.append((index, row))
        return found


def compared(recording: Any) -> Iterator[Seen]:
    """Yield everybody before every camera, compared with the truth or with all other cameras."""
    from scipy.ndimage import maximum_filter1d

    from detector_errors import _in_coco17
    from e3pose.model.noise import LEAST_SCORE
    from e3pose.model.noises import detector_of, load_noise
    from e3pose_lab.noise.calibrate import all_camera_tracks
    from e3pose_lab.noise.residuals import PASSES, SUPPORT_S, SUPPORT_VIEWS, assign_detections
    from e3pose_lab.noise.smoother import smooth

    rig = recording.rig
    noise = load_noise(detector_of(recording))
    scales = np.array([max(c.image_size) for c in rig.cameras]) / noise.image_px
    if recording.truth is None:
        tracks, _ = all_camera_tracks(recording, recording.num_slots)
    else:
        tracks = []
        for path in recording.truth.joints_m.swapaxes(0, 1):
            there = np.flatnonzero(np.isfinite(path).all(axis=(1, 2)))
            if len(there):
                tracks.append((there, path[there]))
    reach = 2 * max(1, round(SUPPORT_S / recording.interval_s)) + 1
    for person in assign_detections(recording, tracks, recording.num_slots):
        person = _in_coco17(person, recording)
        seen = person.scores > LEAST_SCORE
        sigma = np.where(seen, noise.of(person.scores, scales[:, None]), np.inf)
        near = maximum_filter1d(seen.astype(np.int8), reach, axis=0, mode="constant")
        start = person.joints_m
        if recording.truth is None:
            start = smooth(person.keypoints_px, sigma, rig.projections, start, recording.interval_s)
        for number, camera in enumerate(rig.cameras):
            if not seen[:, number].any():
                continue
            path, supported = start, np.ones(seen[:, number].shape, bool)
            if recording.truth is None:
                others = sigma.copy()
                others[:, number] = np.inf
                path = smooth(
                    person.keypoints_px, others, rig.projections, start, recording.interval_s,
                    PASSES,
                )  # fmt: skip
                supported = near.sum(axis=1) - near[:, number] >= SUPPORT_VIEWS
            place = camera.undistort(camera.project(path))
            focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
            m_per_px = (path @ camera.R[2] + camera.t[2]) / focal_px
            use = seen[:, number] & supported & supported[:, MIRROR] & (m_per_px > 0)
            off = []
            for order in (np.arange(17), MIRROR):
                px = np.linalg.norm(person.keypoints_px[:, number] - place[:, order], axis=-1)
                off.append(np.where(use, px * m_per_px, np.nan))
            slots = person.first_slot + np.arange(len(path))
            keypoints = person.keypoints_px[:, number]
            yield Seen(
                slots, *off, person.scores[:, number], keypoints, sights(path, camera), number
            )


def sights(path: Floats, camera: Any) -> NDArray[np.int64]:
    """Return `(num_slots,)` from where a camera sees a person: ahead, behind within 60 degrees."""
    left = path[:, 5] - path[:, 6] + path[:, 11] - path[:, 12]
    ahead = np.stack([left[:, 1], -left[:, 0]], axis=-1)
    towards = (camera.center_m - path[:, 11:13].mean(axis=1))[:, :2]
    lengths = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(towards, axis=-1)
    cosine = (ahead * towards).sum(axis=-1) / np.maximum(lengths, 1e-9)
    return np.where(cosine > 0.5, 0, np.where(cosine < -0.5, 2, 1))


def put_right(recording: Any, views: Sequence[Seen], dropping: bool = False) -> Any:
    """Return the recording with the keypoints of exchanged arms and legs of their own side.

    Args:
        recording: of real detections.
        views: of all its people.
        dropping: leave out those of elbows, wrists, knees and ankles that still lie on the other
            side's, more than `GROSS_M` off.
    """
    names = list(recording.skeleton.joints)
    columns = [names.index(name) for name in coco_joints()]
    series = list(recording.views)
    for one in views:
        camera, mine = recording.rig.cameras[one.camera], series[one.camera]
        keypoints, scores = mine.keypoints_px.copy(), mine.scores.copy()
        again = one.known_again(mine, camera, columns)
        for group, parts in HANGING.items():
            ours = [i for i, name in enumerate(names) if name.endswith(parts) and "_" in name]
            theirs = [names.index(other_side(names[i])) for i in ours]
            exchanged = one.exchanged(group)[0]
            for index, row in again:
                if exchanged[index]:
                    keypoints[row, ours] = mine.keypoints_px[row, theirs]
                    scores[row, ours] = mine.scores[row, theirs]
        for index, row in again if dropping else ():
            lost = [columns[j] for j in np.flatnonzero(one.on_other[index]).tolist()]
            keypoints[row, lost], scores[row, lost] = np.nan, 0.0
        series[one.camera] = replace(mine, keypoints_px=keypoints, scores=scores)
    return replace(recording, views=tuple(series))


def other_side(name: str) -> str:
    """Return the name of the joint on the other side."""
    side, _, part = name.partition("_")
    return f"{OTHER.get(side, side)}_{part}"


def coco_joints() -> tuple[str, ...]:
    """Return the names of joints that `GROUPS` is of."""
    from e3pose.model.skeleton import COCO17

    return tuple(COCO17.joints)


def rates(name: str, recording: Any, views: Sequence[Seen]) -> str:
    """Return a row of a table: how often each group is exchanged."""
    found: Counter[Any] = Counter()
    spells: list[int] = []
    names = coco_joints()
    for one in views:
        arms, some_arms = one.exchanged("arms")
        legs, some_legs = one.exchanged("legs")
        either = some_arms | some_legs
        found["views"] += int(either.sum())
        for what, rows in (
            ("arms alone", arms & ~legs), ("legs alone", legs & ~arms), ("both", arms & legs),
        ):  # fmt: skip
            found[what] += int(rows.sum())
        for sight in range(3):
            found[sight, "views"] += int((either & (one.sight == sight)).sum())
            found[sight] += int(((arms | legs) & (one.sight == sight)).sum())
        for group in (arms, legs):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], group.astype(np.int8), [0]])))
            spells += (edges[1::2] - edges[::2]).tolist()
        for joint, label in enumerate(names):
            if not label.endswith(ENDS):
                continue
            off, other = one.given_m[:, joint], one.other_m[:, joint]
            with np.errstate(invalid="ignore"):
                known, gross = np.isfinite(off), off > GROSS_M
                on_other = gross & (other < off / 2)
            group = arms if joint < 11 else legs
            found["limbs"] += int(known.sum())
            found["gross"] += int(gross.sum())
            found["on other"] += int(on_other.sum())
            found["of these exchanged"] += int((on_other & group).sum())
    total, limbs = max(found["views"], 1), max(found["limbs"], 1)
    cells = [f"{found['views']}"]
    cells += [f"{100 * found[w] / total:.2f}" for w in ("arms alone", "legs alone", "both")]
    cells += [f"{100 * found[s] / max(found[s, 'views'], 1):.2f}" for s in range(3)]
    longest = 1000 * recording.interval_s * max(spells, default=0)
    cells.append(
        f"{1000 * recording.interval_s * np.mean(spells) if spells else 0:.0f}, {longest:.0f}"
    )
    cells += [f"{100 * found[w] / limbs:.2f}" for w in ("gross", "on other", "of these exchanged")]
    return f"| {name} | {' | '.join(cells)} |"


def recordings(options: argparse.Namespace, second: bool) -> Iterator[tuple[str, Any]]:
    """Yield real recordings."""
    from e3pose.recording import load_recording

    shared = shared_folder()
    if "pizza" in options.cases:
        yield "pizza", half(load_recording(shared / "data/pizza/recording"), second)
    if options.clip and "clip" in options.cases:
        yield "clip", load_recording(options.clip)


def simulations(
    wanted: Sequence[str], seeds: Sequence[int], shares: Sequence[float], slots_s: Sequence[float]
) -> Iterator[tuple[str, str, Any]]:
    """Yield simulated cases by what is exchanged: name, variant, recording."""
    from detector_errors import simulated
    from e3pose.simulate import DetectorSettings, Guessing
    from predictor_in_the_loop import captured, seen

    shared = shared_folder() if os.environ.get("E3POSE_SHARED") else None
    for share in shares:
        for scene in SCENES if "scenes" in wanted else ():
            for fps in [f for f in slots_s if f not in (15.0, 30.0)]:
                for seed in seeds:
                    changes = {"given": {"swap": share}, "right": {"swap": 0.0}}
                    if scene.endswith("+"):
                        changes["no guesses"] = {"swap": 0.0, "mirrored": 0.0}
                    for variant, change in changes.items():
                        made = simulated(scene, seed, change, seconds=12.0, fps=fps)
                        yield f"scenes{scene[-1]} {share:.0%} {fps:g}", variant, made
        if shared is None or "motion" not in wanted:
            continue
        for _, joints_m in captured(shared):
            for every in [e for e in (2, 1) if 30.0 / e in slots_s]:
                for variant, (swap, mirrored) in {
                    "given": (share, 0.02), "right": (0.0, 0.02), "no guesses": (0.0, 0.0),
                }.items():  # fmt: skip
                    detector = DetectorSettings(guessing=Guessing(swap=swap, mirrored=mirrored))
                    path = joints_m[::every][: 200 * (3 - every)]
                    fps = 30.0 / every
                    yield f"motion {share:.0%} {fps:g}", variant, seen(path, fps, detector)


def held_out(
    name: str, recording: Any, rates_hz: Sequence[float]
) -> Iterator[tuple[str, str, Case]]:
    """Yield each camera in turn as the judge of the others, as given and put right."""
    from e3pose.evaluate.faults import downsampled
    from e3pose.evaluate.held_out import turns

    views = list(compared(recording))
    print(rates(name, recording, views), flush=True)
    right = put_right(recording, views)
    dropped = put_right(recording, views, dropping=True)
    for fps in rates_hz:
        every = [downsampled(r, fps) if fps < r.fps else r for r in (recording, right, dropped)]
        given, *others = (turns(each, ["each"])[1:] for each in every)
        for (rest, by), (better, _), (fewer, _) in zip(given, *others, strict=True):
            for variant, one in (("given", rest), ("right", better), ("no guesses", fewer)):
                case = Case(f"{name} {fps:g}", one, None, 1 if fps > 20 else 2, by)
                yield f"{name} {fps:g}", variant, case


def cost_cases(options: argparse.Namespace) -> Iterator[Case]:
    """Yield what is replayed, each count of cameras as a case."""
    wanted = options.cases.split(",")

    def with_counts(name: str, variant: str, case: Case) -> Iterator[Case]:
        for count in options.cameras:
            yield replace(case, name=f"{name}, C = {count:g}|{variant}", counts=(count,))

    for name, recording in recordings(options, options.second):
        if name in wanted:
            fps = [f for f in (30.0, 12.5) if f in options.fps] if name == "pizza" else [20.0]
            for label, variant, case in held_out(name, recording, fps):
                yield from with_counts(label, variant, case)
    for name, variant, recording in simulations(wanted, options.seeds, options.shares, options.fps):
        yield from with_counts(name, variant, Case(name, recording, truth_of(recording)))


def costs(options: argparse.Namespace) -> None:
    """Replay what is missing and print how much sides cost."""
    folder = options.out.with_suffix(".work").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "cases.pickle"
    if not made.exists():
        made.write_bytes(pickle.dumps(list(cost_cases(options))))
    done = options.out.read_text().splitlines() if options.out.exists() else []
    rows = {row["version"]: row["found"] for row in map(json.loads, done)}
    for version in (NOW, *([WITHOUT] if options.without else []), *options.versions):
        if version not in rows:
            rows[version] = run(version, made, folder, "round-robin")
            with options.out.open("a") as file:
                file.write(json.dumps({"version": version, "found": rows[version]}) + "\n")
    base = rows[NOW]
    print("| case | as it is | version | sides | error, % | wrong limbs, points |")
    print("|---" * 6 + "|")
    for name in [n for n in base if n.endswith("|given")]:
        case = name.removesuffix("|given")
        before = base[name]
        mm, w = (np.mean([r[figure] for r in before]) for figure in ("mm", "wrong"))
        level = f"{mm:.1f} mm, w {w:.2f} %"
        for version, found in rows.items():
            for variant in ("given", "right", "no guesses"):
                if f"{case}|{variant}" not in found or (version == NOW and variant == "given"):
                    continue
                after = found[f"{case}|{variant}"]
                pairs = list(zip(before, after, strict=True))
                mm = spread([100 * (b["mm"] / a["mm"] - 1) for a, b in pairs])
                w = spread([b["wrong"] - a["wrong"] for a, b in pairs])
                short = {NOW: NOW, WITHOUT: "without the test"}.get(version, version)
                print(f"| {case} ({len(pairs)}) | {level} | {short} | {variant} | {mm} | {w} |")


def spread(changed: Sequence[float]) -> str:
    """Return a mean with its standard error."""
    error = np.nanstd(changed, ddof=1) / len(changed) ** 0.5 if len(changed) > 1 else np.nan
    return f"{np.nanmean(changed):+.2f} ± {error:.2f}"


def identity_cases(options: argparse.Namespace) -> Iterator[tuple[str, Any]]:
    """Yield scenes of people who pass each other."""
    from detector_errors import simulated

    for scene in options.scenes:
        for fps in [f for f in (12.5, 25.0) if f in options.fps]:
            for seed in options.seeds:
                recording = simulated(scene, seed, seconds=options.seconds, fps=fps)
                yield f"{scene} {fps:g}", recording


def measure_identities(made: Path, out: Path, counts: Sequence[float]) -> None:
    """Write what the package that is imported makes of identities."""
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose_lab.reproduce.identity_scores import changes, frames_of, hota, idf1

    found: dict[str, list[dict[str, float]]] = {}
    for name, recording in pickle.loads(made.read_bytes()):
        for count in counts:
            settings = ReplaySettings(
                pipeline="memory", policy="round-robin" if count else "all",
                num_selected=count or float(len(recording.rig)), lead_slots=LEAD,
                warmup_slots=WARMUP,
            )  # fmt: skip
            records = list(replay(recording, settings))
            frames, kinds = frames_of(recording, records), changes(recording, records)
            row = {"idf1": 100 * idf1(frames), "hota": 100 * hota(frames), **kinds}
            row["shown"] = sum(len(f.tracks) for f in frames)
            row["there"] = sum(len(f.actors) for f in frames)
            found.setdefault(f"{name}, C = {count:g}", []).append(row)
    out.write_text(json.dumps(found))


def identities(options: argparse.Namespace) -> None:
    """Replay what is missing and print identity scores."""
    folder = options.out.with_suffix(".work").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / "scenes.pickle"
    if not made.exists():
        made.write_bytes(pickle.dumps(list(identity_cases(options))))
    done = options.out.read_text().splitlines() if options.out.exists() else []
    rows = {row["version"]: row["found"] for row in map(json.loads, done)}
    for version in (NOW, *options.versions):
        if version in rows:
            continue
        out = folder / "identities.json"
        paths = f"{package(version, folder)}{os.pathsep}{ROOT / 'lab' / 'benchmarks'}"
        counts = ",".join(f"{c:g}" for c in options.cameras)
        words = [sys.executable, __file__, "identities", "--measure", str(made), str(out)]
        words += ["--cameras", counts]
        subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": paths})
        rows[version] = json.loads(out.read_text())
        with options.out.open("a") as file:
            file.write(json.dumps({"version": version, "found": rows[version]}) + "\n")
    for version, found in rows.items():
        print(f"\n{version}\n\n| case | IDF1 | HOTA | returned | swapped | lost |")
        print("|---" * 6 + "|")
        for name, runs in found.items():
            cells = [f"{np.mean([r[k] for r in runs]):.2f}" for k in ("idf1", "hota")]
            if version != NOW:
                cells = [
                    spread([b[k] - a[k] for a, b in zip(rows[NOW][name], runs, strict=True)])
                    for k in ("idf1", "hota")
                ]
            cells += [str(sum(r.get(k, 0) for r in runs)) for k in ("returned", "swapped", "lost")]
            print(f"| {name} ({len(runs)}) | {' | '.join(cells)} |")


def main() -> None:
    """Do what is asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=("rates", "costs", "identities"))
    parser.add_argument("versions", nargs="*", help="commits, or MODULE: OLD => NEW")
    parser.add_argument("--clip", type=Path, help="a recording of the demo's videos")
    parser.add_argument("--second", action="store_true", help="the second half of pizza")
    parser.add_argument("--cases", default="pizza,clip,scenes,motion")
    parser.add_argument("--cameras", type=numbers, default=[1.0, 2.0])
    parser.add_argument(
        "--seeds", type=lambda s: [int(x) for x in s.split(",")], default=[2001, 2002]
    )
    parser.add_argument("--fps", type=numbers, default=[12.5, 15.0, 25.0, 30.0])
    parser.add_argument("--shares", type=numbers, default=[0.01])
    parser.add_argument("--scenes", type=lambda s: s.split(","), default=["crossing-", "crossing+"])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--without", action="store_true", help="the filter without its test, too")
    parser.add_argument("--out", type=Path, default=Path("sides.jsonl"))
    parser.add_argument("--measure", nargs=2, type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.what == "costs":
        costs(options)
    elif options.measure:
        measure_identities(*options.measure, options.cameras)
    elif options.what == "identities":
        identities(options)
    else:
        print(
            "| recording | views | arms alone | legs alone | both | ahead | aside | behind"
            " | spell: mean, longest ms | gross limbs | on the other side | of these exchanged |"
        )
        print("|---" * 12 + "|")
        found = list(recordings(options, options.second)) if os.environ.get("E3POSE_SHARED") else []
        from detector_errors import simulated

        for scene in options.scenes:
            made = simulated(scene, options.seeds[0], seconds=options.seconds, fps=25.0)
            found += [
                (f"{scene}, by truth", made),
                (f"{scene}, by the others", replace(made, truth=None)),
            ]
        for name, recording in found:
            print(rates(name, recording, list(compared(recording))), flush=True)


def numbers(text: str) -> list[float]:
    """Return numbers with commas between."""
    return [float(word) for word in text.split(",")]


if __name__ == "__main__":
    main()
