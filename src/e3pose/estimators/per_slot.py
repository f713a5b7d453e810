"""The paper's estimator: match and triangulate every slot by itself, then keep identities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from e3pose.estimators.base import People
from e3pose.fuse import Fuser
from e3pose.pose import Poses2D
from e3pose.track import Tracks, update_tracks


@dataclass(frozen=True, slots=True, eq=False)
class PerSlot:
    """Estimate without a memory; only identities and the past positions are kept.

    Attributes:
        fuser: matching and triangulation.
        num_joints: joints of the detectors' skeleton.
        interval_s: seconds a slot.
        history_slots: the length of the history, at least 2.
    """

    fuser: Fuser
    num_joints: int
    interval_s: float
    history_slots: int = 10

    def begin(self) -> Tracks:
        """See `Estimator.begin`."""
        return Tracks.empty(max(self.history_slots, 2), self.num_joints)

    def estimate(
        self,
        memory: Tracks,
        views: Mapping[int, Poses2D],
        time_s: float,
        clock: Callable[[], float],
    ) -> tuple[Tracks, People]:
        """See `Estimator.estimate`."""
        start = clock()
        poses = self.fuser.fuse(views).poses
        fused = clock()
        tracks, track_ids = update_tracks(memory, poses, self.interval_s)
        stage_s = {"fuse": fused - start, "track": clock() - fused}
        return tracks, People(poses, track_ids, tracks.history_m, stage_s)
