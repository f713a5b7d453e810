"""Residuals of single views against a reference made without them.

A person's path is smoothed over all views but one (`smoother.py`), projected into that one, and
compared with its keypoints. No view is ever compared with itself, and nothing needs a label.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats, Integers
from e3pose.base.nan_statistics import median_of_known
from e3pose.model.camera import Rig
from e3pose.model.noise import LEAST_SCORE, Noise
from e3pose.model.projection import project
from e3pose.recording import Recording
from e3pose_lab.noise.smoother import smooth

SHARED_JOINTS = 5  # that a detection and a track have in common, to tell whether they are one
# The median joint of a detection is nearer than this share of the image to the track it belongs to:
# 40 pixels of 1032, where the simulator and the filter draw the line of gross errors.
SAME_SHARE = 40 / 1032
NEVER = 1e6
SUPPORT_S = 0.12  # the reference is trusted where other views saw the joint this recently
SUPPORT_VIEWS = 2
MIN_SLOTS = 10  # of a track
PASSES = 3  # from the path over all views to that over all but one


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """One track and the detections that belong to it.

    Attributes:
        first_slot: of the track.
        joints_m: `(num_slots, num_joints, 3)` as the pipeline estimated them, gaps closed.
        keypoints_px: `(num_slots, num_cameras, num_joints, 2)` undistorted, NaN where not seen.
        scores: `(num_slots, num_cameras, num_joints)`, 0 where not seen.
    """

    first_slot: int
    joints_m: Floats
    keypoints_px: Floats
    scores: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of keypoints, one row each.

    Attributes:
        errors_px: `(num_keypoints, 2)` keypoint minus reference, in pixels of an image of
            `Noise.image_px`.
        scores: `(num_keypoints,)`.
        cameras: `(num_keypoints,)` index of the camera.
        series: `(num_keypoints,)` one number per track, joint and camera.
        slots: `(num_keypoints,)`.
    """

    errors_px: Floats
    scores: Floats
    cameras: Integers
    series: Integers
    slots: Integers

    def __len__(self) -> int:
        return len(self.scores)


def assign_detections(
    recording: Recording, tracks: Sequence[tuple[Integers, Floats]], num_slots: int
) -> Iterator[Observed]:
    """Give the detections of a recording to its tracks.

    Args:
        recording: all views are used.
        tracks: for each, its slots and joints `(num_there, num_joints, 3)`.
        num_slots: how much of the recording.
    """
    rig = recording.rig
    spans = [(int(slots[0]), int(slots[-1]) + 1) for slots, _ in tracks]
    keypoints, scores, joints = [], [], []
    for (first, end), (slots, joints_m) in zip(spans, tracks, strict=True):
        shape = (end - first, len(rig), len(recording.skeleton))
        keypoints.append(np.full((*shape, 2), np.nan))
        scores.append(np.zeros(shape))
        joints.append(_closed(slots - first, joints_m, end - first))
    for camera, series in enumerate(recording.views):
        scale = max(rig.cameras[camera].image_size)
        for slot in series.slots[series.slots < num_slots].tolist():
            view = series.view(slot)
            there = [i for i, (first, end) in enumerate(spans) if first <= slot < end]
            if view is None or not len(view) or not there:
                continue
            pixels = rig.cameras[camera].undistort(view.keypoints_px)
            known = np.asarray(np.isfinite(pixels).all(axis=-1))
            bodies_m = np.stack([joints[i][slot - spans[i][0]] for i in there])
            expected = project(bodies_m, rig.projections[camera : camera + 1])[0][0]
            good = known & (view.scores > LEAST_SCORE)
            cost = _apart(expected, np.where(good[..., None], pixels, np.nan)) / scale
            rows, people = linear_sum_assignment(np.minimum(cost, NEVER))
            for row, person in zip(rows, people, strict=True):
                if cost[row, person] < SAME_SHARE:
                    place = (there[row], slot - spans[there[row]][0], camera)
                    keypoints[place[0]][place[1:]] = pixels[person]
                    scores[place[0]][place[1:]] = np.where(known[person], view.scores[person], 0.0)
    for (first, _), *parts in zip(spans, joints, keypoints, scores, strict=True):
        yield Observed(first, *parts)


def leave_one_out(
    people: Sequence[Observed],
    rig: Rig,
    noise: Noise,
    interval_s: float,
    progress: Callable[[int], None] = lambda done: None,
) -> Residuals:
    """Compare every view of every person with all other views.

    Args:
        people: with their detections.
        rig: the cameras.
        noise: the errors that the reference expects of keypoints.
        interval_s: seconds per slot.
        progress: called after every person.
    """
    scales = np.array([max(c.image_size) for c in rig.cameras]) / noise.image_px
    reach = 2 * max(1, round(SUPPORT_S / interval_s)) + 1
    parts: list[tuple[NDArray[np.generic], ...]] = []
    for number, person in enumerate(people):
        num_joints = person.scores.shape[2]
        seen = person.scores > LEAST_SCORE
        sigma = np.where(seen, noise.of(person.scores, scales[:, None]), np.inf)
        near = maximum_filter1d(seen.astype(np.int8), reach, axis=0, mode="constant")
        start = smooth(person.keypoints_px, sigma, rig.projections, person.joints_m, interval_s)
        for camera in range(len(rig)):
            if not seen[:, camera].any():
                continue
            others = sigma.copy()
            others[:, camera] = np.inf
            path = smooth(person.keypoints_px, others, rig.projections, start, interval_s, PASSES)
            supported = near.sum(axis=1) - near[:, camera] >= SUPPORT_VIEWS
            pixels, depth, _ = project(path, rig.projections[camera : camera + 1])
            slots, joints = np.nonzero(seen[:, camera] & supported & (depth[0] > 0))
            errors = person.keypoints_px[slots, camera, joints] - pixels[0, slots, joints]
            parts.append(
                (
                    errors / scales[camera],
                    person.scores[slots, camera, joints],
                    np.full(len(slots), camera),
                    (number * len(rig) + camera) * num_joints + joints,
                    slots + person.first_slot,
                )
            )
        progress(number + 1)
    empty = (np.zeros((0, 2)), np.zeros(0), *(np.zeros(0, dtype=np.int64) for _ in range(3)))
    columns = [np.concatenate(column) for column in zip(empty, *parts, strict=True)]
    return Residuals(**dict(zip((f.name for f in fields(Residuals)), columns, strict=True)))


def _apart(expected_px: Floats, found_px: Floats) -> Floats:
    """Return `(num_tracks, num_persons)`: the median distance of joints that both have, or inf."""
    distance = np.linalg.norm(expected_px[:, None] - found_px[None], axis=-1)
    return median_of_known(distance, SHARED_JOINTS, np.inf)


def _closed(slots: Integers, joints_m: Floats, num_slots: int) -> Floats:
    """Return `(num_slots, num_joints, 3)`: gaps closed in time, unknown joints in the middle."""
    middle = np.nanmean(joints_m, axis=(0, 1))
    path = np.empty((num_slots, *joints_m.shape[1:]))
    for joint in range(joints_m.shape[1]):
        known = np.isfinite(joints_m[:, joint]).all(axis=-1)
        for axis in range(3):
            path[:, joint, axis] = (
                np.interp(np.arange(num_slots), slots[known], joints_m[known, joint, axis])
                if known.any()
                else middle[axis]
            )
    return path
