"""Replays with poses smoothed by later slots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.disk_list import DiskList
from e3pose.estimate.base import Posterior
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.estimate.smooth.bodies import smooth_backwards
from e3pose.estimate.smooth.delayed import Delayed, with_smoothed
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Take, motions_of
from e3pose.pipeline import SlotRecord


def smooth_records(
    records: Sequence[SlotRecord],
    posteriors: Sequence[Posterior],
    skeleton: Skeleton,
    lag_slots: int | None = None,
    step: Callable[[SlotRecord], SlotRecord] = lambda record: record,
) -> DiskList[SlotRecord]:
    """Return the records of a replay with the people that the smoother over bodies finds.

    The same people in the same slots, nobody earlier and no joint that was missing.

    Args:
        records: slot by slot.
        posteriors: of the same slots.
        skeleton: of the poses.
        lag_slots: how many later slots each slot may know; None for all.
        step: is given each record that is done, and returns it; not with `lag_slots`.
    """
    if lag_slots is not None:
        delayed = Delayed(skeleton, lag_slots)
        pushed = map(delayed.push, records, posteriors)
        return DiskList(chain((late for late in pushed if late is not None), delayed.flush()))
    tree = grow(skeleton)
    body = proportions_of(skeleton, tree)
    lates = smooth_backwards(tree, reversed(posteriors))
    pairs = zip(reversed(records), lates, strict=True)
    return DiskList((step(with_smoothed(*pair, body)) for pair in pairs), backwards=True)


# definition: how far somebody may go while nobody is seen, metres per second and at once
GAP_MPS, GAP_M = 3.0, 1.0


def keep_people(records: Sequence[SlotRecord], count: int) -> tuple[DiskList[SlotRecord], int]:
    """Return the records with the people who are seen most, numbered from 1, and how many are not.

    Tracks that follow each other in time, no farther apart than somebody can walk meanwhile, are
    one person.

    Args:
        records: slot by slot.
        count: how many people there are.
    """
    joints: Counter[int] = Counter()
    ends: dict[int, list[tuple[float, Floats]]] = {}
    for record in records:
        for person, track_id in enumerate(record.people.track_ids.tolist()):
            known = record.people.scores[person] > 0
            if known.any():
                joints[track_id] += int(known.sum())
                place = record.time_s, record.people.joints_m[person, known].mean(axis=0)
                ends[track_id] = [ends.get(track_id, [place])[0], place]
    chains: list[list[int]] = []
    for track_id, _ in joints.most_common():
        far = [max(_apart(ends[track_id], ends[other]) for other in chain) for chain in chains]
        best = int(np.argmin(far)) if far else -1
        if far and far[best] <= 0:
            chains[best].append(track_id)
        elif len(chains) < count:
            chains.append([track_id])
    numbers = {track_id: row + 1 for row, chain in enumerate(chains) for track_id in chain}
    return DiskList(_numbered(each, numbers) for each in records), len(joints) - len(numbers)


def _apart(one: Sequence[tuple[float, Floats]], other: Sequence[tuple[float, Floats]]) -> float:
    """Return by how much two tracks cannot be one person: at most 0 m if they can."""
    first, second = sorted((one, other), key=lambda ends: ends[0][0])
    (lost_s, lost_m), (found_s, found_m) = first[1], second[0]
    if found_s <= lost_s:
        return np.inf  # at the same time
    return float(np.linalg.norm(found_m - lost_m)) - GAP_M - GAP_MPS * (found_s - lost_s)


def _numbered(record: SlotRecord, numbers: Mapping[int, int]) -> SlotRecord:
    kept = [row for row, i in enumerate(record.people.track_ids.tolist()) if i in numbers]
    people = record.people[np.array(kept, dtype=np.int64)]
    ids = np.array([numbers[i] for i in people.track_ids.tolist()], dtype=np.int64)
    return replace(record, people=replace(people, track_ids=ids))


def take_of_records(
    records: Sequence[SlotRecord], skeleton: Skeleton, interval_s: float, name: str
) -> Take:
    """Return the people of a replay, slot by slot, as a take of this name."""
    slots = np.repeat([record.slot for record in records], [len(r.people) for r in records])
    people = People.joined([record.people for record in records], len(skeleton))
    return Take(name, skeleton, interval_s, motions_of(slots.astype(np.int64), people))


def smooth_poses(
    records: Sequence[SlotRecord], skeleton: Skeleton, interval_s: float, settings: SmoothSettings
) -> DiskList[SlotRecord]:
    """Return the records with poses smoothed by themselves, without what the filter knew besides.

    Args:
        records: slot by slot.
        skeleton: of the poses.
        interval_s: seconds per slot.
        settings: the method; gaps stay as they are.
    """
    take = smoothed(take_of_records(records, skeleton, interval_s, ""), replace(settings, fill_s=0))
    motions = {motion.track_id: motion for motion in take.motions}
    result = DiskList[SlotRecord]()
    for record in records:
        people = record.people
        joints_m, covariance_m2 = people.joints_m.copy(), people.covariance_m2.copy()
        for person, track_id in enumerate(people.track_ids.tolist()):
            motion = motions[track_id]
            row = record.slot - motion.first
            joints_m[person] = motion.joints_m[row]
            with np.errstate(invalid="ignore", divide="ignore"):
                less = (motion.sigma_m[row] / people.sigma_m[person]) ** 2
            covariance_m2[person] *= np.where(np.isfinite(less), less, 1.0)[:, None, None]
        people = replace(people, joints_m=joints_m, full_covariance_m2=covariance_m2)
        result.append(replace(record, people=people))
    return result
