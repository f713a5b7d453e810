"""Keep identities over time: associate the 3D poses of a slot with the tracks of the slots before.

This is the paper's data plane, which has no filter: a track's joints are the triangulated ones, and
its history is what the predictor is given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.known import mean_of_known
from e3pose.model.pose import Poses3D

# tuned: m | not recorded | not measured
GATE_M = 0.4  # mean joint distance explained by estimation noise of two triangulated poses
# tuned: m/s | not recorded | not measured
GATE_SPEED_MPS = 4.0  # how fast a person may move away from where they were last seen
# tuned: m | not recorded | not measured
GATE_LIMIT_M = 1.5  # beyond this two poses are never the same person, however long ago
# tuned: s | not recorded | not measured
END_AFTER_S = 1.0  # a track without a pose for this long ends


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """People followed over slots.

    Attributes:
        track_ids: `(num_tracks,)` unique within a run, rising.
        history_m: `(num_slots, num_tracks, num_joints, 3)` oldest first, the last being the newest
            slot; NaN where a joint was not estimated or the person was not there yet.
        unseen: `(num_tracks,)` slots since the last pose; 0 when seen in the newest slot.
        filled_m: `(num_tracks, num_joints, 3)` the newest pose with what it lacked (`filled`).
        next_id: the id that the next new person gets.
    """

    track_ids: NDArray[np.int64]
    history_m: Floats
    unseen: NDArray[np.int64]
    filled_m: Floats
    next_id: int = 0

    def __len__(self) -> int:
        return len(self.track_ids)

    @classmethod
    def empty(cls, num_slots: int, num_joints: int) -> Tracks:
        """Return no tracks, with room for a history of `num_slots`."""
        none = np.zeros(0, dtype=np.int64)
        nobody = np.zeros((num_slots, 0, num_joints, 3))
        return cls(none, nobody, none, nobody[0])

    def last_known_m(self) -> Floats:
        """Return `(num_tracks, num_joints, 3)`: each joint where it was last estimated."""
        known: Floats = self.history_m[-1]
        for earlier in self.history_m[-2::-1]:
            known = np.where(np.isnan(known), earlier, known)
        return known


def update_tracks(
    tracks: Tracks, poses: Poses3D, interval_s: float
) -> tuple[Tracks, NDArray[np.int64]]:
    """Associate one slot's poses with the tracks, start new tracks and end old ones.

    Args:
        tracks: the tracks after the previous slot.
        poses: the people of this slot.
        interval_s: seconds per slot.

    Returns:
        The tracks after this slot, and `(num_persons,)` the track id of every pose.
    """
    rows, columns = associate(tracks, poses, interval_s)
    ids = np.full(len(poses), -1, dtype=np.int64)
    ids[columns] = tracks.track_ids[rows]
    new = np.flatnonzero(ids < 0)
    ids[new] = tracks.next_id + np.arange(len(new))

    num_slots, _, num_joints, _ = tracks.history_m.shape
    newest = np.full((len(tracks), num_joints, 3), np.nan)
    newest[rows] = poses.joints_m[columns]
    history = np.concatenate([tracks.history_m[1:], newest[None]])
    unseen = tracks.unseen + 1
    unseen[rows] = 0
    keep = unseen * interval_s <= END_AFTER_S
    filled_m = tracks.filled_m.copy()
    filled_m[rows] = filled(tracks.filled_m[rows], poses.joints_m[columns])

    started = np.full((num_slots, len(new), num_joints, 3), np.nan)
    started[-1] = poses.joints_m[new]
    return (
        Tracks(
            np.concatenate([tracks.track_ids[keep], ids[new]]),
            np.concatenate([history[:, keep], started], axis=1),
            np.concatenate([unseen[keep], np.zeros(len(new), dtype=np.int64)]),
            np.concatenate([filled_m[keep], poses.joints_m[new]]),
            tracks.next_id + len(new),
        ),
        ids,
    )


def filled(before_m: Floats, joints_m: Floats) -> Floats:
    """Return poses with the joints that they lack, as far as they were known before.

    A missing joint keeps its last offset from the joint, of those that are there, which it was
    nearest to. The paper's section 2 names post-processing; its Table 1 is at hand only with it
    (`docs/research/paper-comparison.md`).

    Args:
        before_m: `(num_persons, num_joints, 3)` the same people before, filled; NaN where unknown.
        joints_m: `(num_persons, num_joints, 3)` now; NaN where missing.
    """
    there = np.asarray(np.isfinite(joints_m).all(axis=-1))
    known = np.asarray(np.isfinite(before_m).all(axis=-1))
    apart = np.linalg.norm(before_m[:, :, None] - before_m[:, None], axis=-1)
    apart = np.where((there & known)[:, None], np.nan_to_num(apart, nan=np.inf), np.inf)
    nearest = apart.argmin(axis=-1)[..., None]
    moved_m = np.take_along_axis(joints_m - before_m, nearest, axis=1)
    lacks = ~there & known & (there & known).any(axis=-1, keepdims=True)
    return np.where(lacks[..., None], before_m + moved_m, joints_m)


def associate(
    tracks: Tracks, poses: Poses3D, interval_s: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of tracks and of poses that are the same person, by least total distance."""
    from scipy.optimize import linear_sum_assignment  # takes longer to import than all else here

    distance = _distances(tracks.last_known_m(), poses.joints_m)
    gate = np.minimum(GATE_M + GATE_SPEED_MPS * interval_s * (tracks.unseen + 1), GATE_LIMIT_M)
    excess = np.where(distance <= gate[:, None], distance, GATE_LIMIT_M * 100)
    rows, columns = linear_sum_assignment(excess)
    accepted = distance[rows, columns] <= gate[rows]
    return rows[accepted].astype(np.int64), columns[accepted].astype(np.int64)


def _distances(first_m: Floats, second_m: Floats) -> Floats:
    """Mean distance over shared joints; between centroids where there is none; else inf."""
    by_joint = mean_of_known(np.linalg.norm(first_m[:, None] - second_m[None], axis=-1))
    centroids = np.linalg.norm(_centroids(first_m)[:, None] - _centroids(second_m)[None], axis=-1)
    otherwise = np.where(np.isfinite(centroids), centroids, np.inf)
    return np.where(np.isfinite(by_joint), by_joint, otherwise)


def _centroids(joints_m: Floats) -> Floats:
    present = np.asarray(np.isfinite(joints_m).all(axis=-1))
    total = np.where(present[..., None], joints_m, 0.0).sum(axis=-2)
    count = present.sum(axis=-1)
    return np.where(count[..., None] > 0, total / np.maximum(count, 1)[..., None], np.nan)
