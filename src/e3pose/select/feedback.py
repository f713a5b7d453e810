"""Semantic feedback: predicted people projected into every selected camera.

After Bultmann and Behnke, "Real-time multi-view 3D human pose estimation using semantic feedback to
smart edge sensors" (RSS 2021). What cameras do with it is in `detectors.focus`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.base import Outlook
from e3pose.model.camera import Rig
from e3pose.model.expected import ExpectedView

# The 90 % distance over the mean one, of a normal error in three dimensions.
NINE_OF_TEN = 1.567  # definition: of a normal error
MIN_DEPTH_M = 0.3  # physical: somebody nearer fills the image
# Of predictions that state no error: the 90 % distance of `constant-velocity` in the pipeline
# `paper`, three simulated scenes of seed 701, leads of 1 to 6 slots of 0.04 and 0.08 s.
# tuned: m | three simulated scenes, seed 701, leads of 1 to 6 slots | is that error itself, by the
#   truth
USUAL_ERROR_M = 0.08
# tuned: m/s | three simulated scenes, seed 701, leads of 1 to 6 slots | is that error itself, by
#   the truth
USUAL_ERROR_MPS = 1.1


@dataclass(frozen=True, slots=True)
class Feedback:
    """Boxes of expected people for each camera; some detections use the full frame.

    Attributes:
        whole_every: one of so many detections of a camera uses the full frame.
    """

    whole_every: int

    def is_due(self, focused: Integers, selected: Flags) -> bool:
        """Return whether full-frame detection is due for some selected camera.

        Then all of them use it: two must see a newcomer at about the same time.

        Args:
            focused: `(num_cameras,)` detections since each camera's last full-frame detection.
            selected: `(num_cameras,)`.
        """
        return bool((selected & (focused >= self.whole_every - 1)).any())


def focused_after(
    focused: Integers, selected: Flags, expected: tuple[ExpectedView, ...] | None
) -> Integers:
    """Return `(num_cameras,)` detections since each camera's last full-frame detection.

    Args:
        focused: the same before the selection.
        selected: `(num_cameras,)`.
        expected: what the cameras are told; None for full-frame detection.
    """
    return np.where(selected, 0, focused) if expected is None else focused + selected


def expected_people(
    rig: Rig,
    joints_m: Floats,
    error_m: Floats,
    outlook: Outlook,
    predicted_ids: Integers,
    ahead_s: float,
) -> tuple[ExpectedView, ...] | None:
    """Return the expected views of predicted and of unpublished people.

    Tracks that too few cameras have seen are not published, but expected as well; otherwise only
    full-frame detection would find them.

    Args:
        rig: the cameras.
        joints_m: `(num_tracks, num_joints, 3)` predicted metres of those who are published.
        error_m: `(num_tracks, num_joints)` expected distance of these; NaN where unknown.
        outlook: of the same slot, with all tracks.
        predicted_ids: `(num_tracks,)` of `joints_m`.
        ahead_s: seconds from the newest slot to that one.

    Returns:
        One view per camera; None where nobody is expected.
    """
    people = outlook.expected
    hidden_m = people.joints_m[~np.isin(people.track_ids, predicted_ids)]
    most = max(joints_m.shape[1], hidden_m.shape[1])  # of these, fingers and skin are unknown
    joints_m, hidden_m = (
        np.pad(each, ((0, 0), (0, most - each.shape[1]), (0, 0)), constant_values=np.nan)
        for each in (joints_m, hidden_m)
    )
    joints_m = np.concatenate([joints_m, hidden_m])
    if not len(joints_m):
        return None
    error_m = np.concatenate([error_m, np.full(hidden_m.shape[:2], np.nan)])
    return expected_in_views(rig, joints_m, reach_m(error_m, ahead_s))


def reach_m(error_m: Floats, ahead_s: float) -> Floats:
    """Return the radius in pixels that holds nine of ten of a person's joints.

    Args:
        error_m: `(num_tracks, num_joints)` expected distance from the truth; NaN where unknown.
        ahead_s: seconds from the newest slot to the one that is predicted.

    Returns:
        `(num_tracks,)` metres.
    """
    usual_m = USUAL_ERROR_M + USUAL_ERROR_MPS * ahead_s
    known = np.isfinite(error_m)
    mean_m = np.where(known, error_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.where(known.any(axis=1), NINE_OF_TEN * mean_m, usual_m)


def expected_in_views(rig: Rig, joints_m: Floats, reach_m: Floats) -> tuple[ExpectedView, ...]:
    """Return the expected views of people in each camera.

    Args:
        rig: the cameras.
        joints_m: `(num_tracks, num_joints, 3)` predicted metres; NaN where unknown.
        reach_m: `(num_tracks,)` from `reach_m`.

    Returns:
        One view per camera, with the people of whom it may see something.
    """
    pixels = rig.project(joints_m)  # (num_cameras, num_tracks, num_joints, 2)
    known = np.isfinite(joints_m)
    middle_m = np.where(known, joints_m, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    axes = rig.projections[:, 2]  # (num_cameras, 4): K leaves the depth as it is
    depth_m = np.maximum(axes[:, :3] @ middle_m.T + axes[:, 3:], MIN_DEPTH_M)
    focal_px = np.array([[(camera.K[0, 0] + camera.K[1, 1]) / 2] for camera in rig.cameras])
    reach_px = focal_px * reach_m / depth_m  # (num_cameras, num_tracks)
    margin = reach_px[..., None, None]
    with np.errstate(invalid="ignore"):
        near = (pixels > -margin) & (pixels < rig.image_sizes[:, None, None] + margin)
    seen = near.all(axis=-1).any(axis=-1)
    return tuple(
        ExpectedView(keypoints_px[shown], reach[shown])
        for keypoints_px, reach, shown in zip(pixels, reach_px, seen, strict=True)
    )
