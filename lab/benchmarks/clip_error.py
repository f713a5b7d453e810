"""How far a few cameras are off what all of them say: for recordings without truth.

    python lab/benchmarks/clip_error.py RECORDING --policies round-robin --cameras 1,2,all --leads 4
    python lab/benchmarks/clip_error.py RECORDING --reference FILE --joints hip,knee

The reference is the offline smoother over every view of every camera (`e3pose_lab.noise.smoother`).
With `--reference` it is read from a file, or written to it if there is none: make it once, at the
revision to compare with, so that a change is not measured by itself.

With `--by-joint` each row is followed by the mean error and `in 90` of each joint.

With `--loose-limbs` it does not hold arms and legs to lengths that people have.

Compared are the joints that at least two cameras saw within 0.12 s, after the warm-up; people one
to one, below 0.5 m on average. `found` is the share of the people of the reference who are shown,
`more` that of shown people who are nobody of the reference. Each row is over several phases of the
turns. `lag ms` is the shift in time at which the estimate fits the reference best, and `at lag` the
mean error there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Noise
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.noise import LEAST_SCORE
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.skeleton import Skeleton
from e3pose.model.uncertainty import distance_within_m
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, load_recording
from e3pose_lab.noise.calibrate import all_camera_tracks, first_slots
from e3pose_lab.noise.residuals import (
    SUPPORT_S,
    SUPPORT_VIEWS,
    assign_detections,
)
from e3pose_lab.noise.smoother import smooth

LAGS_S = np.arange(-0.04, 0.1201, 0.005)
SAME_M = 0.5  # an estimate farther than this from everybody is of nobody
FAR_M = 1e3
WORST = 12


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """One person as all cameras saw them.

    Attributes:
        first_slot: of the person.
        joints_m: `(num_slots, num_joints, 3)` metres, NaN where too few cameras saw the joint.
    """

    first_slot: int
    joints_m: Floats

    def at(self, slot: float) -> Floats:
        """Return `(num_joints, 3)` between slots; NaN outside the person's time."""
        place = slot - self.first_slot
        if not 0 <= place <= len(self.joints_m) - 1:
            return np.full(self.joints_m.shape[1:], np.nan)
        low = min(int(place), len(self.joints_m) - 2) if len(self.joints_m) > 1 else 0
        share = place - low
        if share == 0:
            return np.asarray(self.joints_m[low])
        return np.asarray((1 - share) * self.joints_m[low] + share * self.joints_m[low + 1])


def references(recording: Recording, noise: Noise, limbs: bool = True) -> list[Reference]:
    """Return everybody as the smoother over all views sees them; limbs of one length each."""
    body = proportions_of(recording.skeleton.joints, grow(recording.skeleton))
    tracks, _ = all_camera_tracks(recording, recording.num_slots)
    scales = np.array([max(c.image_size) for c in recording.rig.cameras]) / noise.image_px
    reach = 2 * max(1, round(SUPPORT_S / recording.interval_s)) + 1
    found = []
    for person in assign_detections(recording, tracks, recording.num_slots):
        seen = person.scores > LEAST_SCORE
        sigma = np.where(seen, noise.of(person.scores, scales[:, None]), np.inf)
        path = smooth(
            person.keypoints_px,
            sigma,
            recording.rig.projections,
            person.joints_m,
            recording.interval_s,
            rigid=body if limbs else None,
        )
        near = maximum_filter1d(seen.astype(np.int8), reach, axis=0, mode="constant").sum(axis=1)
        found.append(
            Reference(person.first_slot, np.where((near >= SUPPORT_VIEWS)[..., None], path, np.nan))
        )
    return found


def saved_references(path: Path, make: Callable[[], list[Reference]]) -> list[Reference]:
    """Return the references in a file; make and write them where there is none."""
    if not path.exists():
        people = make()
        arrays = {f"{index}_{each.first_slot}": each.joints_m for index, each in enumerate(people)}
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    with np.load(path) as arrays:
        return [Reference(int(name.split("_")[1]), arrays[name]) for name in arrays.files]


def named_joints(skeleton: Skeleton, names: str) -> NDArray[np.int64]:
    """Return the rows of the joints of these names, of either side; all without any."""
    wanted = names.split(",") if names else []
    ends = [name.removeprefix("left_").removeprefix("right_") for name in skeleton.joints]
    for name in wanted:
        if name not in ends:
            raise SystemExit(f"--joints: found {name!r}, expected some of {', '.join(ends)}")
    return np.array([row for row, end in enumerate(ends) if end in wanted or not wanted])


@dataclass(slots=True)
class Errors:
    """What was compared, over slots and replays.

    Attributes:
        rows: of the joints that are compared; None for all.
    """

    rows: NDArray[np.int64] | None = None
    joints: list[Floats] = field(default_factory=list)  # metres
    inside: list[NDArray[np.bool_]] = field(default_factory=list)  # the stated 90 % distance
    lagged: list[Floats] = field(default_factory=list)  # mean by lag, metres
    cameras: list[int] = field(default_factory=list)
    people: list[tuple[int, int, int]] = field(default_factory=list)  # found, there, shown
    worst: list[tuple[float, int, int, int]] = field(default_factory=list)
    which: list[NDArray[np.int64]] = field(default_factory=list)  # the rows of `joints`

    def add(self, record: SlotRecord, people: Sequence[Reference], interval_s: float) -> None:
        """Compare the people of a slot with the references nearest to them."""
        self.cameras.append(int(record.selected.sum()))
        truth = np.array([person.at(record.slot) for person in people])
        rows = np.arange(truth.shape[1]) if self.rows is None else self.rows
        poses_m = record.poses.joints_m
        apart = np.minimum(mean_errors_m(poses_m[:, rows], truth[:, rows]), FAR_M)
        pairs = [pair for pair in zip(*linear_sum_assignment(apart), strict=True)]
        pairs = [pair for pair in pairs if apart[pair] < SAME_M]
        there = np.isfinite(truth[:, rows]).all(axis=-1).any(axis=-1)
        self.people.append((len(pairs), int(there.sum()), len(poses_m)))
        for person, nearest in pairs:
            off = np.linalg.norm(poses_m[person] - truth[nearest], axis=-1)[rows]
            known = np.isfinite(off)
            within = distance_within_m(record.covariance_m2[person][rows][known], 0.9)
            self.joints.append(off[known])
            self.which.append(rows[known])
            self.inside.append(off[known] <= within)
            shifted = np.array([people[nearest].at(record.slot - s / interval_s) for s in LAGS_S])
            lags = np.linalg.norm(poses_m[person] - shifted, axis=-1)[:, rows]
            if np.isfinite(lags[:, known]).all():
                self.lagged.append(lags[:, known].mean(axis=1))
            for j in np.flatnonzero(known):
                self.worst.append((off[j], record.slot, int(nearest), int(rows[j])))

    def by_joint(self, skeleton: Skeleton) -> Iterator[str]:
        """Yield the mean error of each joint, left and right together, and the share in 90 %."""
        off, inside = 1000 * np.concatenate(self.joints), np.concatenate(self.inside)
        ends = [name.removeprefix("left_").removeprefix("right_") for name in skeleton.joints]
        names = np.array(ends)[np.concatenate(self.which)]
        for end in dict.fromkeys(ends):
            mine = names == end
            if mine.any():
                yield f"    {end:12} {off[mine].mean():6.1f} {100 * inside[mine].mean():6.1f}"

    def line(self) -> str:
        """Return the figures."""
        off = 1000 * np.concatenate(self.joints)
        lagged = 1000 * np.mean(self.lagged, axis=0)
        best = int(lagged.argmin())
        found, there, shown = np.sum(self.people, axis=0)
        return (
            f"{np.mean(self.cameras):7.2f} {off.mean():6.1f} {np.quantile(off, 0.95):6.0f} "
            f"{np.quantile(off, 0.99):6.0f} {off.max():6.0f} "
            f"{100 * np.concatenate(self.inside).mean():6.1f} "
            f"{1000 * LAGS_S[best]:7.0f} {lagged[best]:7.1f} "
            f"{100 * found / there:6.1f} {100 * (shown - found) / shown:5.1f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--policies", default="round-robin,information")
    parser.add_argument("--cameras", default="2")
    parser.add_argument("--leads", default="4")
    parser.add_argument("--phases", type=int, default=4, help="replays a row")
    parser.add_argument("--warmup", type=int, default=10, help="slots with all cameras, left out")
    parser.add_argument("--fps", type=float, help="leave slots out")
    parser.add_argument("--share", type=float, default=1.0, help="of the recording, from its start")
    parser.add_argument("--joints", default="", help="compared, of both sides, such as elbow,wrist")
    parser.add_argument("--reference", type=Path, help="file to read the reference from, or write")
    parser.add_argument(
        "--loose-limbs", dest="limbs", action="store_false", help="a reference without lengths"
    )
    parser.add_argument("--worst", action="store_true", help="list the worst joints of each row")
    parser.add_argument("--by-joint", action="store_true", help="mean and in 90 of each joint")
    options = parser.parse_args()
    recording = load_recording(options.recording)
    if options.fps:
        recording = downsampled(recording, options.fps)
    if options.share < 1:
        recording = first_slots(recording, round(options.share * recording.num_slots))
    rows = named_joints(recording.skeleton, options.joints)
    noise = load_noise(detector_of(recording))

    def make() -> list[Reference]:
        return references(recording, noise, options.limbs)

    people = saved_references(options.reference, make) if options.reference else make()
    print(f"{recording.name}: {recording.num_slots} slots, {len(people)} people")
    print(
        "policy        C lead cameras   mean   95 %   99 %    max  in 90  lag ms  at lag  found"
        "  more"
    )
    for policy in options.policies.split(","):
        for count in cameras_of(options.cameras, recording):
            for lead in (int(lead) for lead in options.leads.split(",")):
                errors = Errors(rows)
                settings = ReplaySettings(
                    pipeline="memory",
                    policy=policy,
                    num_selected=count,
                    lead_slots=lead,
                    warmup_slots=options.warmup,
                )
                for phase in range(options.phases):
                    for record in replay(recording, replace(settings, phase=phase, seed=phase)):
                        if record.slot >= options.warmup + lead - 1:
                            errors.add(record, people, recording.interval_s)
                name = f"{policy:11} {count:3g} {lead:3d}"
                print(f"{name} {errors.line()}", flush=True)
                if options.by_joint:
                    print("\n".join(errors.by_joint(recording.skeleton)))
                if options.worst:
                    for off, slot, person, joint in sorted(errors.worst)[: -WORST - 1 : -1]:
                        name = recording.skeleton.joints[joint]
                        print(f"    {1000 * off:5.0f} mm  slot {slot} person {person} {name}")


def cameras_of(text: str, recording: Recording) -> list[float]:
    """Return the numbers of cameras per slot; `all` are those of the rig."""
    return [len(recording.rig) if part == "all" else float(part) for part in text.split(",")]


if __name__ == "__main__":
    main()
