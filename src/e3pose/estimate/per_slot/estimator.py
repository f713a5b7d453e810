"""The paper's estimator: match and triangulate every slot by itself, then keep identities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from e3pose.estimate.base import Estimate, Expected, Outlook
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.estimate.per_slot.track import Tracks, update_tracks
from e3pose.model.noise import Noise
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.predict.base import Prediction

# tuned: m | simulated scenes, by the share of joints in the band | not measured
JOINT_SIGMA_M = 0.025  # an axis: its 90 % band holds 91 to 95 % of the joints on simulated scenes
# tuned: m, score | not recorded | not measured
FILLED_SIGMA_M, FILLED_SCORE = 0.1, 0.1  # of joints that were filled
# Nothing is carried on: before a slot is seen its joints are only known to be near the last ones.
# tuned: m | by reasoning | not measured
UNSEEN_SIGMA_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class PerSlot:
    """Estimate without a memory; only identities and the past positions are kept.

    Attributes:
        fuser: matching and triangulation.
        num_joints: joints of the detectors' skeleton.
        interval_s: seconds per slot.
        noise: of the detector's keypoints, for the outlook.
        history_slots: the length of the history, at least 2.
        fills: show joints that a slot lacks where the person had them last (`track.filled`).
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

    def steer(self, memory: Tracks, prediction: Prediction, interval_s: float) -> Tracks:
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
