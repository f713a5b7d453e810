"""Which estimate is nearest to the truth, to learn from where nobody knows the truth?

Simulated people, whose truth judges and is used for nothing else. Prints the mean distance of a
joint from the truth, and of its motion over four slots, which is what a predictor learns.

    python lab/benchmarks/bench_targets.py
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Model
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import StepKernel
from e3pose.estimate.per_slot.estimator import Tracks, update_tracks
from e3pose.estimate.per_slot.fuse import Fuser, FusionSettings
from e3pose.model.noises import load_noise
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.prediction.motion import body_joints
from e3pose_lab.train.estimates import (
    EstimateSettings,
    Followed,
    clearly_seen,
    follow,
    views_of,
)
from e3pose_lab.train.smooth import smooth

SIMULATED = load_noise("simulated")


REFERENCE = EstimateSettings()
SECONDS = 20.0
SCENES = (("ring", 11), ("crossing", 12), ("meeting", 13))
SOMEBODY_ELSE_M = 0.5


def slot_by_slot(recording: Recording) -> list[Followed]:
    """Return everybody as all cameras see them without a memory, outliers left out."""
    fuser = Fuser(recording.rig, len(recording.skeleton), FusionSettings(reject_outliers=True))
    tracks = Tracks.empty(2, len(recording.skeleton))
    seen: dict[int, list[tuple[int, Floats]]] = {}
    for slot in range(recording.num_slots):
        poses = fuser.fuse(views_of(recording, slot)).people
        tracks, ids = update_tracks(tracks, poses, recording.interval_s)
        for track, joints in zip(ids.tolist(), poses.joints_m, strict=True):
            seen.setdefault(track, []).append((slot, joints))
    return [_joined(parts) for parts in seen.values()]


def with_memory(recording: Recording) -> list[Followed]:
    """Return everybody as the filter with a memory sees them from all cameras."""
    estimator = Filtered(Model(recording.rig, recording.skeleton, SIMULATED), StepKernel(), 2)
    memory = estimator.begin()
    seen: dict[int, list[tuple[int, Floats]]] = {}
    for slot in range(recording.num_slots):
        views = views_of(recording, slot)
        memory, found = estimator.estimate(memory, views, slot * recording.interval_s, float)
        people = found.people
        for track, joints in zip(people.track_ids.tolist(), people.joints_m, strict=True):
            seen.setdefault(track, []).append((slot, joints))
    return [_joined(parts) for parts in seen.values()]


def _joined(parts: list[tuple[int, Floats]]) -> Followed:
    slots = np.array([slot for slot, _ in parts])
    joints = np.full((slots[-1] - slots[0] + 1, *parts[0][1].shape), np.nan)
    joints[slots - slots[0]] = [pose for _, pose in parts]
    return Followed(int(slots[0]), joints)


def _smoothed(recording: Recording, people: list[Followed]) -> list[Followed]:
    return [Followed(p.first_slot, smooth(p.joints_m, recording.interval_s)) for p in people]


def errors_mm(recording: Recording, people: list[Followed]) -> tuple[float, float]:
    """Return the mean distance from the truth, and that of the motion over four slots."""
    assert recording.truth is not None
    truth = body_joints(recording.truth.joints_m, recording.truth.skeleton)
    places, motions = [], []
    for person in people:
        joints = body_joints(person.joints_m, recording.skeleton)
        slots = np.arange(len(joints)) + person.first_slot
        apart = np.linalg.norm(joints[:, None] - truth[slots], axis=-1)
        mean = np.where(np.isfinite(apart), apart, 1.0).mean(axis=-1)
        who = mean.argmin(axis=1)
        own = truth[slots, who]
        places.append(apart[np.arange(len(joints)), who].ravel())
        same = np.repeat((who[4:] == who[:-4])[:, None], joints.shape[1], axis=1)
        off = np.linalg.norm((joints[4:] - joints[:-4]) - (own[4:] - own[:-4]), axis=-1)
        motions.append(np.where(same, off, np.nan).ravel())
    return _mean_mm(places), _mean_mm(motions)


def _mean_mm(parts: list[Floats]) -> float:
    values = np.concatenate(parts)
    return 1000 * float(values[values < SOMEBODY_ELSE_M].mean())


def main() -> None:
    """Print the table."""
    print("| scene | target | place, mm | motion over 4 slots, mm |\n|---|---|---|---|")
    for scene, seed in SCENES:
        recording = simulate(SceneSettings(scene=scene, seconds=SECONDS), seed)
        fused, filtered = slot_by_slot(recording), with_memory(recording)
        sure = follow(recording, 0, recording.num_slots, REFERENCE)
        targets = {
            "all cameras, slot by slot": fused,
            "the same, smoothed": _smoothed(recording, fused),
            "filter with a memory": filtered,
            "filter with a memory, smoothed": _smoothed(recording, filtered),
            "the same, where it is sure (taken)": sure,
            "the three cameras with the least occlusion (paper)": clearly_seen(recording, sure, 3),
        }
        for name, people in targets.items():
            place, motion = errors_mm(recording, people)
            print(f"| {scene} | {name} | {place:.1f} | {motion:.1f} |")


if __name__ == "__main__":
    main()
