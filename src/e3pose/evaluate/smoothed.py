"""Replays with poses smoothed by later slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.base import Posterior
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.estimate.smooth.bodies import smooth_bodies
from e3pose.estimate.smooth.delayed import Delayed, with_smoothed
from e3pose.model.pose import Poses3D
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Take, motion_of
from e3pose.model.uncertainty import axis_sigma_m
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
        delayed = Delayed(skeleton.joints, lag_slots)
        found = map(delayed.push, records, posteriors)
        return [*(late for late in found if late is not None), *delayed.flush()]
    tree = grow(skeleton)
    body = proportions_of(skeleton.joints, tree)
    pairs = zip(records, smooth_bodies(tree, posteriors), strict=True)
    return [with_smoothed(record, late, body) for record, late in pairs]


def take_of_records(
    records: Sequence[SlotRecord], skeleton: Skeleton, interval_s: float, name: str
) -> Take:
    """Return the people of a replay, slot by slot, as a take of this name."""
    rows: dict[int, list[tuple[SlotRecord, int]]] = {}
    for record in records:
        for person, track_id in enumerate(record.track_ids.tolist()):
            rows.setdefault(track_id, []).append((record, person))
    motions = [
        motion_of(
            track_id,
            np.array([record.slot for record, _ in own], dtype=np.int64),
            np.stack([record.poses.joints_m[person] for record, person in own]),
            np.stack([axis_sigma_m(record.covariance_m2[person]) for record, person in own]),
            np.stack([record.poses.scores[person] for record, person in own]),
            np.stack([record.measured[person] for record, person in own]),
            _dynamics(own),
        )
        for track_id, own in sorted(rows.items())
    ]
    return Take(name, skeleton, interval_s, tuple(motions))


def _dynamics(own: Sequence[tuple[SlotRecord, int]]) -> Floats | None:
    found = [r.dynamics[person] for r, person in own if r.dynamics is not None]
    return np.stack(found) if len(found) == len(own) else None


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
        joints_m = record.poses.joints_m.copy()
        covariance_m2 = record.covariance_m2.copy()
        for person, track_id in enumerate(record.track_ids.tolist()):
            motion = motions[track_id]
            row = record.slot - motion.first
            joints_m[person] = motion.joints_m[row]
            before = axis_sigma_m(covariance_m2[person])
            with np.errstate(invalid="ignore", divide="ignore"):
                less = (motion.sigma_m[row] / before) ** 2
            covariance_m2[person] *= np.where(np.isfinite(less), less, 1.0)[:, None, None]
        poses = Poses3D(joints_m, record.poses.scores)
        result.append(replace(record, poses=poses, covariance_m2=covariance_m2))
    return result
