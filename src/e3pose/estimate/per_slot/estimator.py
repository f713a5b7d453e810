"""The paper's estimator: match and triangulate every slot by itself, then keep identities.

The 3D poses of a slot are associated with the tracks of the slots before. This is the paper's data
plane, which has no filter: a track's joints are the triangulated ones, and
its history is what the predictor is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.base.nan_statistics import mean_of_known
from e3pose.estimate.base import Estimate, Expected, History, Outlook
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.model.noise import Noise
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.predict.base import Predictor

# tuned: m | simulated scenes | by the truth 91 to 95 % of the joints are in the 90 % band
JOINT_SIGMA_M = 0.025  # an axis: its 90 % band holds 91 to 95 % of the joints on simulated scenes
# tuned: m, score | not recorded | by the labels of Shelf, a held-out camera and the truth half and
#   twice: the same, but 0.7 % less error in one of five cases with twice the score
FILLED_SIGMA_M, FILLED_SCORE = 0.1, 0.1  # of joints that were filled
# tuned: m | not recorded | by the truth of six scenes half and twice: 0.0 and 0.8 changes of
#   identity more in 16 s; none: 10 more
GATE_M = 0.4  # mean joint distance explained by estimation noise of two triangulated poses
GATE_SPEED_MPS = 4.0  # physical: how fast a person may move away from where they were last seen
# tuned: m | not recorded | by the truth of six scenes half and twice: 0.5 and 0.4 % less error, as
#   many changes of identity; of Shelf half 0.5 % less error, twice 0.1 % more
GATE_LIMIT_M = 1.5  # beyond this two poses are never the same person, however long ago
END_AFTER_S = 1.0  # timeout: a track without a pose for this long ends
# Nothing is carried on: before a slot is seen a joint is wherever a person gets until a track ends.
UNSEEN_SIGMA_M = GATE_SPEED_MPS * END_AFTER_S  # definition


@dataclass(frozen=True, slots=True, eq=False)
class PerSlot:
    """Estimate without a memory; only identities and the past positions are kept.

    Attributes:
        fuser: matching and triangulation.
        num_joints: joints of the detectors' skeleton.
        interval_s: seconds per slot.
        noise: of the detector's keypoints, for the outlook.
        history_slots: the length of the history, at least 2.
        fills: show joints that a slot lacks where the person had them last (`filled`).
    """

    fuser: Fuser
    num_joints: int
    interval_s: float
    noise: Noise
    history_slots: int = 10
    fills: bool = True

    def begin(self) -> Tracks:
        """See `Estimator.begin`."""
        return Tracks.empty(self.history_slots, self.num_joints)

    def estimate(
        self,
        memory: Tracks,
        views: Mapping[int, Poses2D],
        time_s: float,
        clock: Callable[[], float],
    ) -> tuple[Tracks, Estimate]:
        """See `Estimator.estimate`."""
        start = clock()
        found = self.fuser.fuse(views).people
        fused = clock()
        tracks, track_ids = update_tracks(memory, found, self.interval_s)
        stage_s = {"fuse": fused - start, "track": clock() - fused}
        joints_m, scores = found.joints_m, found.scores
        placed = np.asarray(scores > 0)
        if self.fills:
            joints_m = tracks.filled_m[tracks.history.track_ids.searchsorted(track_ids)]
            there = np.isfinite(joints_m).all(axis=-1)
            scores = np.where(placed, scores, np.where(there, FILLED_SCORE, 0.0))
        known_m = np.where(scores > 0, FILLED_SIGMA_M, np.nan)
        sigma_m = np.where(placed, JOINT_SIGMA_M, known_m)
        people = People(track_ids, joints_m, scores, placed, sigma_m)
        return tracks, Estimate(people, tracks.history, stage_s)

    def steer(self, memory: Tracks, predictor: Predictor, interval_s: float) -> Tracks:
        """See `Estimator.steer`; estimates per slot expect no motion."""
        return memory

    def leave_out_ids(self, memory: Tracks, count: int) -> Tracks:
        """See `Estimator.leave_out_ids`."""
        return replace(memory, next_id=memory.next_id + count)

    def forget_people(self, memory: Tracks) -> Tracks:
        """See `Estimator.forget_people`."""
        return replace(self.begin(), next_id=memory.next_id)

    def outlook(self, memory: Tracks, ahead_s: float) -> Outlook:
        """See `Estimator.outlook`.

        Without a memory there is no camera whose errors persist, nor one known to deliver.
        """
        joints_m = memory.last_known_m()
        known = np.asarray(np.isfinite(joints_m).all(axis=-1))
        covariance = np.zeros((*known.shape, 6, 6))
        covariance[..., :3, :3] = UNSEEN_SIGMA_M**2 * np.eye(3)
        count = np.maximum(known.sum(axis=-1), 1)[:, None, None]
        middle = np.where(known[..., None], joints_m, 0.0).sum(axis=1, keepdims=True) / count
        num_cameras = len(self.fuser.rig)
        shape = (len(memory), num_cameras)
        sizes = np.array([max(camera.image_size) for camera in self.fuser.rig.cameras])
        expected = Expected(
            track_ids=memory.history.track_ids,
            confirmed=memory.unseen == 0,
            joints_m=np.where(known[..., None], joints_m, middle),
            covariance=covariance,
            drift_m2ps3=np.zeros(known.shape),
            velocity_lasts_s=np.ones(known.shape[1]),
            delivered=np.ones(shape),
            shows=np.ones(shape),
            last_seen_s=np.full(shape, np.inf),
            sigma_px=self.noise.sigma_px.min() * sizes / self.noise.image_px,
        )
        return Outlook(
            expected=expected,
            has_memory=False,
            detection_map=None,
            memory=self.noise.memory,
            bias_share=0.0,
            unexplained=np.zeros(num_cameras, dtype=np.int64),
            unexplained_s=np.full(num_cameras, np.inf),
            wait_s=0.0,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """People followed over slots.

    Attributes:
        history: of the tracks; their ids are unique within a run and rise.
        unseen: `(num_tracks,)` slots since the last pose; 0 when seen in the newest slot.
        filled_m: `(num_tracks, num_joints, 3)` the newest pose with what it lacked (`filled`).
        next_id: the id that the next new person gets.
    """

    history: History
    unseen: Integers
    filled_m: Floats
    next_id: int = 1

    def __post_init__(self) -> None:
        if len(self.history.track_ids) != len(self.unseen):  # of a damaged checkpoint
            counts = f"{len(self.history.track_ids)} and {len(self.unseen)} tracks"
            raise InputError("history", counts, "the same")

    def __len__(self) -> int:
        return len(self.unseen)

    @classmethod
    def empty(cls, num_slots: int, num_joints: int) -> Tracks:
        """Return no tracks, with room for a history of `num_slots`."""
        none = np.zeros(0, dtype=np.int64)
        return cls(History.empty(num_slots, num_joints), none, np.zeros((0, num_joints, 3)))

    def last_known_m(self) -> Floats:
        """Return `(num_tracks, num_joints, 3)`: each joint where it was last estimated."""
        known, *before = self.history.joints_m[::-1]
        for earlier in before:
            known = np.where(np.isnan(known), earlier, known)
        return np.asarray(known)


def update_tracks(tracks: Tracks, people: People, interval_s: float) -> tuple[Tracks, Integers]:
    """Associate one slot's people with the tracks, start new tracks and end old ones.

    Args:
        tracks: the tracks after the previous slot.
        people: of this slot, before identity.
        interval_s: seconds per slot.

    Returns:
        The tracks after this slot, and `(num_people,)` the track id of every person.
    """
    rows, columns = associate(tracks, people, interval_s)
    ids = np.full(len(people), -1, dtype=np.int64)
    ids[columns] = tracks.history.track_ids[rows]
    new = np.flatnonzero(ids < 0)
    ids[new] = tracks.next_id + np.arange(len(new))

    newest = np.full_like(tracks.filled_m, np.nan)
    newest[rows] = people.joints_m[columns]
    unseen = tracks.unseen + 1
    unseen[rows] = 0
    keep = unseen * interval_s <= END_AFTER_S
    filled_m = tracks.filled_m.copy()
    filled_m[rows] = filled(tracks.filled_m[rows], people.joints_m[columns])
    history = tracks.history.after(
        np.concatenate([tracks.history.track_ids[keep], ids[new]]),
        np.concatenate([newest[keep], people.joints_m[new]]),
    )
    return (
        Tracks(
            history,
            np.concatenate([unseen[keep], np.zeros(len(new), dtype=np.int64)]),
            np.concatenate([filled_m[keep], people.joints_m[new]]),
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


def associate(tracks: Tracks, people: People, interval_s: float) -> tuple[Integers, Integers]:
    """Return the rows of tracks and of people that are the same, by least total distance."""
    from scipy.optimize import linear_sum_assignment  # takes longer to import than all else here

    distance = _distances(tracks.last_known_m(), people.joints_m)
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
