"""Detections of several cameras -> motion to learn from, where nobody knows the truth.

The paper's expanded data (section 4.2): what every combination of cameras makes of a person in a
slot is what a predictor may be given. What it should say is that of the filter with a memory from
all cameras, where it is sure, smoothed with the slots before and after, so that it is better than
anything that a running system knows (`lab/benchmarks/bench_targets.py`); or, as the paper has it
for live video, the estimate of the cameras with the least occlusion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.estimate import EstimatorSettings, estimator_maker
from e3pose.estimate.per_slot.estimator import GATE_M
from e3pose.estimate.per_slot.fuse import Fuser, FusionSettings
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.predict.normalise import common_columns
from e3pose.recording import Recording
from e3pose.select.occlusion import occlusion, person_boxes
from e3pose_lab.prediction.normalise import to_common
from e3pose_lab.train.smooth import smooth
from e3pose_lab.train.windows import Clip
from e3pose_lab.workers import Workers

Halves = NDArray[np.float16]
Views = Mapping[int, Poses2D]

MIN_VIEWS = 2
CHUNK_SLOTS = 50  # a task: seconds of work, so that workers are busy to the end
FOLLOWING = 0.3  # share of the work, roughly
LEAST_SCORE = 0.95  # of a joint to aim at: a standard deviation of 23 mm, by the filter's own word
SOME_VIEWS = FusionSettings(refine_steps=0)  # the paper's DLT, as it runs in the loop


@dataclass(frozen=True, slots=True)
class EstimateSettings:
    """Settings of the estimates made of combinations of cameras.

    Attributes:
        combinations: camera combinations fused in a slot at most; all of them where there are no
            more, else as many drawn anew in every slot.
        seed: of these draws.
        least_occluded: aim at what so many cameras see in whose views people hide each other
            least, as the paper does for live video; 0 aims at the filter's estimate.
    """

    combinations: int = 32
    seed: int = 0
    least_occluded: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """Common data of all chunks of a recording: cameras, skeleton of detections, settings."""

    rig: Rig
    skeleton: Skeleton
    settings: EstimateSettings


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """One person over a stretch of slots as all cameras see them.

    Attributes:
        first_slot: of the stretch.
        joints_m: `(num_slots, num_joints, 3)` metres, smoothed; NaN where unknown.
    """

    first_slot: int
    joints_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A task: some slots of a recording.

    Attributes:
        first_slot: of the chunk, which also seeds its draws.
        views: per slot.
        people: per slot, rows of `Followed` and their joints `(num_persons, num_joints, 3)`.
    """

    first_slot: int
    views: tuple[Views, ...]
    people: tuple[tuple[NDArray[np.int64], Floats], ...]


def estimated_clips(
    recording: Recording,
    shortest: int,
    stretches: Sequence[tuple[int, int]],
    settings: EstimateSettings,
    workers: Workers,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Clip]:
    """Return the motion of everybody whom all cameras of a recording together can follow.

    Args:
        recording: with detections of at least two cameras; its truth is not used.
        shortest: slots of the shortest clip of use.
        stretches: half-open ranges of slots to use; nothing else is read, and nobody is
            followed from one into the next.
        settings: what to make of the cameras.
        workers: who does it; the result does not depend on them.
        progress: called with the share that is done.
    """
    people = []
    for done, stretch in enumerate(stretches, start=1):
        followed = follow(recording, *stretch, settings)
        if settings.least_occluded:
            followed = clearly_seen(recording, followed, settings.least_occluded)
        people += followed
        progress(FOLLOWING * done / len(stretches))
    chunks = [
        _chunk(recording, people, first, min(first + CHUNK_SLOTS, stop))
        for start, stop in stretches
        for first in range(start, stop, CHUNK_SLOTS)
    ]
    room = Room(recording.rig, recording.skeleton, settings)
    count = len(camera_combinations(len(recording.rig), settings.combinations, None))
    errors = [np.full((len(p.joints_m), count, 14, 3), np.nan, np.float16) for p in people]
    for done, (chunk, found) in enumerate(
        zip(chunks, workers.run(estimates_of, room, chunks), strict=True), start=1
    ):
        for slot, (rows, _) in enumerate(chunk.people, start=chunk.first_slot):
            for row, error in zip(rows.tolist(), found[slot - chunk.first_slot], strict=True):
                errors[row][slot - people[row].first_slot] = error
        progress(FOLLOWING + (1 - FOLLOWING) * done / len(chunks))
    columns = common_columns(recording.skeleton)
    clips = []
    for number, (person, error) in enumerate(zip(people, errors, strict=True)):
        joints = to_common(person.joints_m, columns).astype(np.float32)
        name = f"{recording.name}, person {number + 1}"
        whole = Clip(name, joints, recording.fps, errors_m=error)
        clips += whole.without_gaps(shortest)
    return clips


def follow(
    recording: Recording, start: int, stop: int, settings: EstimateSettings
) -> list[Followed]:
    """Return everybody as all cameras see them from slot `start` to before `stop`, smoothed."""
    estimator = estimator_maker("memory")(
        EstimatorSettings(
            rig=recording.rig,
            skeleton=recording.skeleton,
            interval_s=recording.interval_s,
            history_slots=2,
            fusion=SOME_VIEWS,
            noise=load_noise(detector_of(recording)),
        ),
    )
    memory = estimator.begin()
    seen: dict[int, list[tuple[int, Floats]]] = {}
    for slot in range(start, stop):
        views = views_of(recording, slot)
        memory, found = estimator.estimate(memory, views, slot * recording.interval_s, float)
        people = found.people
        sure = people.scores[..., None] >= LEAST_SCORE
        joints_m = np.where(sure, people.joints_m, np.nan)
        for track, joints in zip(people.track_ids.tolist(), joints_m, strict=True):
            seen.setdefault(track, []).append((slot, joints))
    followed = []
    for track in sorted(seen):
        slots = np.array([slot for slot, _ in seen[track]])
        joints = np.full((slots[-1] - slots[0] + 1, len(recording.skeleton), 3), np.nan)
        joints[slots - slots[0]] = [pose for _, pose in seen[track]]
        followed.append(Followed(int(slots[0]), smooth(joints, recording.interval_s)))
    return followed


def clearly_seen(recording: Recording, people: Sequence[Followed], count: int) -> list[Followed]:
    """Return people where the `count` cameras with the least occlusion of a slot see them.

    Joints that these lack, and people whom they miss, stay where all cameras together see them.
    """
    fuser = Fuser(recording.rig, len(recording.skeleton), SOME_VIEWS)
    moved = [person.joints_m.copy() for person in people]
    ends = [person.first_slot + len(person.joints_m) for person in people]
    for slot in range(min((p.first_slot for p in people), default=0), max(ends, default=0)):
        rows = [row for row, person in enumerate(people) if person.first_slot <= slot < ends[row]]
        if not rows:
            continue
        views = least_occluded(recording.rig, views_of(recording, slot), count)
        found_m = fuser.fuse(views).people.joints_m
        there = np.array([moved[row][slot - people[row].first_slot] for row in rows])
        for mine, pose in zip(*joined(there, found_m), strict=True):
            place = moved[rows[mine]][slot - people[rows[mine]].first_slot]
            place[:] = np.where(np.isfinite(found_m[pose]), found_m[pose], place)
    return [
        Followed(person.first_slot, joints_m)
        for person, joints_m in zip(people, moved, strict=True)
    ]


def least_occluded(rig: Rig, views: Views, count: int) -> Views:
    """Return the `count` views of a slot in which people's boxes overlap least, paper eq. (4).

    Views of nobody do not count; of several as clear the one of most people is taken.
    """
    seen = {camera: view for camera, view in views.items() if len(view)}
    overlap = {
        camera: float(occlusion(person_boxes(view.keypoints_px, rig.cameras[camera].image_size)))
        for camera, view in seen.items()
    }
    order = sorted(seen, key=lambda camera: (overlap[camera], -len(seen[camera]), camera))
    return {camera: seen[camera] for camera in order[:count]}


def camera_combinations(
    num_cameras: int, at_most: int, rng: np.random.Generator | None
) -> list[tuple[int, ...]]:
    """Return the combinations of two or more cameras: all, or `at_most` of them drawn by `rng`.

    Without `rng` the first ones are returned, to be counted.
    """
    total = 2**num_cameras - num_cameras - 1
    if total <= at_most:
        return [
            chosen
            for size in range(MIN_VIEWS, num_cameras + 1)
            for chosen in combinations(range(num_cameras), size)
        ]
    if rng is None:
        return [()] * at_most
    # With many cameras nearly all combinations are of half of them: draw the number first, so
    # that two and three cameras, which the system likes to wake, are seen too.
    sizes = rng.integers(MIN_VIEWS, num_cameras + 1, at_most)
    return [tuple(sorted(rng.choice(num_cameras, size, replace=False).tolist())) for size in sizes]


def estimates_of(room: Room, chunk: Chunk) -> list[Halves]:
    """Return per slot of a chunk how far off its people are in each camera combination.

    Returns:
        `(num_persons, num_combinations, NUM_COMMON, 3)` metres per slot: the estimate less what all
        cameras say; NaN where a joint is missing. A person whom only some combinations find has
        these repeated in place of the others, so that one drawn at random is one of theirs.
    """
    fuser = Fuser(room.rig, len(room.skeleton), SOME_VIEWS)
    columns = common_columns(room.skeleton)
    rng = np.random.default_rng([room.settings.seed, chunk.first_slot])
    result = []
    for views, (_, wanted) in zip(chunk.views, chunk.people, strict=True):
        chosen = camera_combinations(len(room.rig), room.settings.combinations, rng)
        target = to_common(wanted, columns)
        errors = np.full((len(wanted), len(chosen), *target.shape[1:]), np.nan)
        for number, cameras in enumerate(chosen if len(wanted) else []):
            some = {camera: views[camera] for camera in cameras if camera in views}
            if len(some) < MIN_VIEWS:
                continue
            found = to_common(fuser.fuse(some).people.joints_m, columns)
            rows, people = joined(target, found)
            errors[rows, number] = found[people] - target[rows]
        result.append(_repeated(errors).astype(np.float16))
    return result


def joined(target_m: Floats, found_m: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows of the people and of the poses that are theirs, by least total distance."""
    apart = np.linalg.norm(target_m[:, None] - found_m[None], axis=-1)
    shared = np.isfinite(apart)
    mean = np.where(shared, apart, 0.0).sum(axis=-1) / np.maximum(shared.sum(axis=-1), 1)
    mean = np.where(shared.any(axis=-1), mean, math.inf)
    rows, columns = linear_sum_assignment(np.minimum(mean, 100 * GATE_M))
    near = mean[rows, columns] <= GATE_M
    return rows[near].astype(np.int64), columns[near].astype(np.int64)


def _repeated(errors_m: Floats) -> Floats:
    """Fill the combinations that lost a person with those that found them, in turn."""
    for person in errors_m:
        found = np.flatnonzero(np.isfinite(person).any(axis=(1, 2)))
        if len(found):
            person[:] = person[np.resize(found, len(person))]
    return errors_m


def _chunk(
    recording: Recording,
    people: Sequence[Followed],
    first: int,
    stop: int,
) -> Chunk:
    there = []
    for slot in range(first, stop):
        rows = [
            row
            for row, person in enumerate(people)
            if 0 <= slot - person.first_slot < len(person.joints_m)
        ]
        joints = [people[row].joints_m[slot - people[row].first_slot] for row in rows]
        shape = (len(rows), len(recording.skeleton), 3)
        there.append((np.array(rows, dtype=np.int64), np.array(joints).reshape(shape)))
    views = tuple(views_of(recording, slot) for slot in range(first, stop))
    return Chunk(first, views, tuple(there))


def views_of(recording: Recording, slot: int) -> dict[int, Poses2D]:
    """Return the views of a slot by camera, without lost ones."""
    found = {camera: recording.view(slot, camera) for camera in range(len(recording.rig))}
    return {camera: view for camera, view in found.items() if view is not None}
