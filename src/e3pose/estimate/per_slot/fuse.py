"""Fuse the views of one slot into 3D poses: match and triangulate."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.estimate.per_slot.fusion import Fused as Fused
from e3pose.estimate.per_slot.fusion import Fusion as Fusion
from e3pose.estimate.per_slot.fusion import FusionSettings as FusionSettings
from e3pose.estimate.per_slot.slot import SlotKernel
from e3pose.model.camera import Rig
from e3pose.model.people import People
from e3pose.model.pose import Poses2D

MAX_POSES = 4096  # capacity: in one slot, all views together: 1 GB of working memory at most


class Fuser:
    """Fuses slots of one rig; holds the constants of the rig and no history.

    Args:
        rig: the calibrated cameras.
        num_joints: joints of every pose.
        settings: thresholds.

    A fuser reuses its working memory, so it must not be shared between threads.
    """

    def __init__(
        self,
        rig: Rig,
        num_joints: int,
        settings: FusionSettings | None = None,
    ) -> None:
        if num_joints < 1:
            raise InputError(f"fusion: num_joints: found {num_joints}, expected 1 or more")
        self.rig = rig
        self.num_joints = num_joints
        self.settings = settings or FusionSettings()
        self._run: Callable[[Floats, Floats, Integers], Fused] = SlotKernel(
            rig, num_joints, self.settings
        )

    def warm_up(self) -> None:
        """Compile, or load from the cache, all that a slot needs; takes seconds the first time."""
        shape = (len(self.rig), 1, self.num_joints)
        for score in (0.0, 1.0):
            self.fuse_arrays(
                np.zeros((*shape, 2)), np.full(shape, score), np.ones(len(self.rig), np.int64)
            )

    def fuse(self, views: Mapping[int, Poses2D]) -> Fusion:
        """Fuse the views that arrived; cameras without a view are simply absent.

        Args:
            views: camera index to what it saw.

        Raises:
            InputError: on an unknown camera, another number of joints, or more than `MAX_POSES`.
        """
        for camera, view in views.items():
            if not 0 <= camera < len(self.rig):
                raise InputError(
                    f"fusion: view of camera {camera}: expected 0 to {len(self.rig) - 1}"
                )
            if view.scores.shape[1] != self.num_joints:
                raise InputError(
                    f"camera {self.rig.cameras[camera].camera_id}: found {view.scores.shape[1]} "
                    f"joints, expected {self.num_joints}"
                )
        counts = np.zeros(len(self.rig), np.int64)
        for camera, view in views.items():
            counts[camera] = len(view)
        _check_total(int(counts.sum()))
        shape = (len(self.rig), int(counts.max()), self.num_joints)
        keypoints = np.full((*shape, 2), np.nan)
        scores = np.zeros(shape)
        for camera, view in views.items():
            keypoints[camera, : len(view)] = view.keypoints_px
            scores[camera, : len(view)] = view.scores
        return self.fuse_arrays(keypoints, scores, counts)

    def fuse_arrays(
        self,
        keypoints_px: NDArray[np.floating],
        scores: NDArray[np.floating],
        counts: NDArray[np.integer],
    ) -> Fusion:
        """Fuse views that are already in one array: the fast path.

        Args:
            keypoints_px: `(num_cameras, max_persons, num_joints, 2)` pixels in the real images.
            scores: `(num_cameras, max_persons, num_joints)` in [0, 1]. A keypoint counts as missing
                where its score is NaN or below `MISSING_SCORE`, or its pixels are not finite; a
                score above 1 is 1.
            counts: `(num_cameras,)` people in each view; rows from there on are ignored.

        Raises:
            InputError: on a wrong shape or count, or more than `MAX_POSES` poses.
        """
        keypoints = np.ascontiguousarray(keypoints_px, dtype=np.float64)
        joint_scores = np.ascontiguousarray(scores, dtype=np.float64)
        people = np.ascontiguousarray(counts, dtype=np.int64)
        shape = joint_scores.shape
        if (
            len(shape) != 3
            or shape[0] != len(self.rig)
            or shape[2] != self.num_joints
            or keypoints.shape != (*shape, 2)
            or people.shape != shape[:1]
        ):
            raise InputError(
                f"fusion: found arrays of shapes {keypoints.shape}, {shape} and {people.shape}, "
                f"expected ({len(self.rig)}, max_persons, {self.num_joints}, 2), the same without "
                f"the 2, and ({len(self.rig)},)"
            )
        listed = people.tolist()
        if min(listed) < 0 or max(listed) > shape[1]:
            raise InputError(f"fusion: counts: found {listed}, expected 0 to {shape[1]} people")
        _check_total(sum(listed))
        joints, joint_scores, members, error = self._run(keypoints, joint_scores, people)
        return Fusion(People.unchecked(joints, joint_scores), members, error)


def _check_total(total: int) -> None:
    if total > MAX_POSES:
        raise InputError(f"fusion: found {total} poses in one slot, expected at most {MAX_POSES}")
