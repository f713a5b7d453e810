"""Replays with poses smoothed by later slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from e3pose.estimate.base import Posterior
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.estimate.smooth.bodies import smooth_bodies
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
) -> list[SlotRecord]:
    """Return the records of a replay with the people that the smoother over bodies finds.

    The same people in the same slots, nobody earlier and no joint that was missing.

    Args:
        records: slot by slot.
        posteriors: of the same slots.
        skeleton: of the poses.
        lag_slots: how many later slots each slot may know; None for all.
    """
    if lag_slots is not None:
        delayed = Delayed(skeleton, lag_slots)
        found = map(delayed.push, records, posteriors)
        return [*(late for late in found if late is not None), *delayed.flush()]
    tree = grow(skeleton)
    body = proportions_of(skeleton, tree)
    pairs = zip(records, smooth_bodies(tree, posteriors), strict=True)
    return [with_smoothed(record, late, body) for record, late in pairs]


def take_of_records(
    records: Sequence[SlotRecord], skeleton: Skeleton, interval_s: float, name: str
) -> Take:
    """Return the people of a replay, slot by slot, as a take of this name."""
    slots = np.repeat([record.slot for record in records], [len(r.people) for r in records])
    people = People.joined([record.people for record in records], len(skeleton))
    return Take(name, skeleton, interval_s, motions_of(slots.astype(np.int64), people))


def smooth_poses(
    records: Sequence[SlotRecord], skeleton: Skeleton, interval_s: float, settings: SmoothSettings
) -> list[SlotRecord]:
    """Return the records with poses smoothed by themselves, without what the filter knew besides.

    Args:
        records: slot by slot.
        skeleton: of the poses.
        interval_s: seconds per slot.
        settings: the method; gaps stay as they are.
    """
    take = smoothed(take_of_records(records, skeleton, interval_s, ""), replace(settings, fill_s=0))
    motions = {motion.track_id: motion for motion in take.motions}
    result = []
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
