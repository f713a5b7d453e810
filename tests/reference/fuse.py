"""Fusing in plain numpy: what the compiled fuser is held against, to 1e-6 m."""

from __future__ import annotations

import math

import numpy as np
from tests.reference.match import match
from tests.reference.triangulate import refine, reprojection_error, triangulate

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.per_slot.fuse import Fused, Fuser, FusionSettings
from e3pose.estimate.per_slot.triangulate import MIN_VIEWS
from e3pose.model.camera import Rig
from e3pose.model.pose import MAX_PIXEL, MISSING_SCORE


class ReferenceFuser(Fuser):
    """A `Fuser` without a kernel that matches by rays."""

    def __init__(self, rig: Rig, num_joints: int, settings: FusionSettings | None = None) -> None:
        super().__init__(rig, num_joints, settings)
        self._run = self._reference

    def _undistort(self, keypoints: Floats, counts: Integers) -> Floats:
        keypoints = keypoints.copy()
        for index, camera in enumerate(self.rig.cameras):
            rows = keypoints[index, : counts[index]]
            with np.errstate(invalid="ignore"):
                usable = (np.abs(rows) <= MAX_PIXEL).all(axis=-1)
            rows[usable] = camera.undistort(rows[usable])
        return keypoints

    def _reference(self, keypoints: Floats, scores: Floats, counts: Integers) -> Fused:
        present = np.arange(keypoints.shape[1]) < counts[:, None]
        cameras, rows = np.nonzero(present)
        keypoints = self._undistort(keypoints, counts)
        keypoints, scores = keypoints[present], scores[present]  # (num_poses, num_joints, ...)
        with np.errstate(invalid="ignore"):
            seen = (np.abs(keypoints) <= MAX_PIXEL).all(axis=-1) & (scores >= MISSING_SCORE)
        keypoints = np.where(seen[..., None], keypoints, np.nan)
        scores = np.where(seen, np.minimum(scores, 1.0), 0.0)
        settings = self.settings
        groups = match(
            self._rays(keypoints, cameras),
            self.rig.centers_m[cameras],
            scores,
            cameras,
            settings.max_distance_m,
            settings.cap_m,
        )
        fused: list[Fused] = []
        for group in groups:
            if len(group) < MIN_VIEWS:
                continue
            # A sum must not depend on the order in which the group came together.
            poses = sorted(group, key=lambda pose: int(cameras[pose]))
            joints, joint_scores, error = self._place(
                keypoints[poses], scores[poses], self.rig.projections[cameras[poses]]
            )
            enough = min(settings.min_joints, self.num_joints)
            if np.isfinite(joints[:, 0]).sum() < enough:
                continue
            if any(_mean_distance(joints, other[0]) < settings.duplicate_m for other in fused):
                continue
            members = np.full(len(self.rig), -1, np.int64)
            members[cameras[poses]] = rows[poses]
            fused.append((joints, joint_scores, members, error))
        if not fused:
            none = np.zeros((0, self.num_joints))
            members = np.zeros((0, len(self.rig)), np.int64)
            return np.zeros((0, self.num_joints, 3)), none, members, none
        joints, joint_scores, members, error = (np.stack(part) for part in zip(*fused, strict=True))
        return joints, joint_scores, members, error

    def _rays(self, keypoints: Floats, cameras: Integers) -> Floats:
        homogeneous = np.concatenate([keypoints, np.ones_like(keypoints[..., :1])], axis=-1)
        rays = np.einsum("pab,pjb->pja", self.rig.ray_matrices[cameras], homogeneous)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def _place(
        self, keypoints: Floats, scores: Floats, projections: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Triangulate one person: joints, their scores and reprojection errors."""
        joints = triangulate(keypoints, scores, projections)
        joints, belief = refine(
            joints,
            keypoints,
            scores,
            projections,
            self.settings.steps,
            self.settings.reject_outliers,
        )
        found = np.isfinite(joints).all(axis=-1)
        count = np.maximum((scores > 0).sum(axis=0), 1)
        joint_scores = np.where(found, (scores * belief).sum(axis=0) / count, 0.0)
        return joints, joint_scores, reprojection_error(joints, keypoints, scores, projections)


def _mean_distance(first: Floats, second: Floats) -> float:
    """Return the mean distance over the joints that both have; infinite if they share none."""
    distance = np.linalg.norm(first - second, axis=-1)
    shared = np.isfinite(distance)
    return float(distance[shared].mean()) if shared.any() else math.inf
