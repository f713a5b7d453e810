"""Extrinsics from walking people: matched 2D poses, with or without a rough start."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from e3pose.calibrate.bundle import placed
from e3pose.calibrate.from_points import PointRig, adjust_all, pair_poses, solve_points
from e3pose.calibrate.progress import Progress, silent
from e3pose.calibrate.same_people import (
    Evidence,
    Seen,
    group,
    pair_by_essential,
    pair_by_rig,
)
from e3pose.calibrate.tracklets import find_tracklets
from e3pose.errors import InputError
from e3pose.geometry.camera import Rig
from e3pose.model.noise import Noise
from e3pose.recording.record import Recording

Floats = NDArray[np.float64]

MIN_SCORE = 0.3
FOCAL_SIGMA = 0.25  # of a lens that is assumed
ROUGH_SIGMAS = (25.0, 10.0, 5.0)  # tolerances of matching, from a rough start
FINE_SIGMAS = (4.0, 3.0)
DOUBTED_SIGMAS = 15.0  # of a rig that may be off
FINAL_POINTS = 8000


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """The joints of matched people, as points.

    Attributes:
        keypoints_px: `(num_cameras, num_points, 2)` real pixels; NaN where not seen.
        sigma_px: `(num_cameras, num_points)` standard deviations.
        person: `(num_points,)` whose.
        slot: `(num_points,)` when.
        joint: `(num_points,)` which.
    """

    keypoints_px: Floats
    sigma_px: Floats
    person: NDArray[np.int64]
    slot: NDArray[np.int64]
    joint: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PeopleRig:
    """A rig solved from people.

    Attributes:
        solved: cameras, points and residuals; its `used` are points of `joints`.
        joints: the matched joints.
        people: how many persons, or parts of their walks, were matched.
        inliers: share of observations within three standard deviations.
    """

    solved: PointRig
    joints: Joints
    people: int
    inliers: float


def solve_people(
    recording: Recording,
    noise: Noise,
    start: Rig | None,
    progress: Progress = silent,
) -> PeopleRig:
    """Place the cameras of a recording by the people in it; scale and world are left as they come.

    Args:
        recording: detections; the lenses of its rig are used, and focal lengths found where a lens
            is assumed.
        noise: what scores promise.
        start: where the cameras are thought to be, within some 10 degrees and half a metre; None
            to begin from nothing.
        progress: takes a stage, its steps done and steps in all.

    Raises:
        InputError: when too few people are seen by several cameras.
    """
    rig = recording.rig
    seen = observe_people(recording, noise)
    cameras = {
        tracklet.camera
        for tracklet, ideal in zip(seen.tracklets, seen.ideal, strict=True)
        if np.isfinite(ideal).any()
    }
    missing = [name for i, name in enumerate(rig.camera_ids) if i not in cameras]
    if missing:
        raise InputError(
            f"cameras: {', '.join(missing)}: found no track there, expected people "
            "who walk about in every view"
        )
    focal = np.array([FOCAL_SIGMA if camera.lens_assumed else 0.0 for camera in rig.cameras])
    best: PeopleRig | None = None
    if start is not None:
        best = _from_start(recording, noise, seen, start, focal, progress)
    if best is None or best.inliers < 0.6:
        other = _from_nothing(recording, noise, seen, focal, progress)
        if other is not None and (best is None or other.inliers > best.inliers):
            best = other
    if best is None:
        raise InputError(
            "recording: no two cameras agree on where people are, expected people who walk about, "
            "seen by pairs of cameras at the same time; are the videos synchronised (e3pose sync)?"
        )
    return best


def observe_people(recording: Recording, noise: Noise) -> Seen:
    """Follow people in each view and take the lenses off their joints."""
    tracklets, ideal, sigma = [], [], []
    for index, (camera, series) in enumerate(
        zip(recording.rig.cameras, recording.views, strict=True)
    ):
        scale = max(camera.image_size) / noise.image_px
        good = series.scores >= MIN_SCORE
        points = camera.normalise(np.where(good[..., None], series.keypoints_px, np.nan))
        deviations = noise.of(series.scores, scale) / camera.K[0, 0]
        for tracklet in find_tracklets(index, series, recording.fps):
            tracklets.append(tracklet)
            ideal.append(points[tracklet.rows])
            sigma.append(deviations[tracklet.rows])
    return Seen(tracklets, ideal, sigma)


def gather(recording: Recording, noise: Noise, seen: Seen, groups: list[list[int]]) -> Joints:
    """Make points of the joints of people who were matched across views."""
    num_joints = len(recording.skeleton)
    keys: dict[tuple[int, int], int] = {}
    for person, members in enumerate(groups):
        slots = np.concatenate([seen.tracklets[m].slots for m in members])
        for slot, count in zip(*np.unique(slots, return_counts=True), strict=True):
            if count >= 2:
                keys[person, int(slot)] = len(keys)
    shape = (len(recording.rig), len(keys), num_joints)
    pixels, sigma = np.full((*shape, 2), np.nan), np.ones(shape)
    for person, members in enumerate(groups):
        for member in members:
            tracklet = seen.tracklets[member]
            series, camera = (
                recording.views[tracklet.camera],
                recording.rig.cameras[tracklet.camera],
            )
            scale = max(camera.image_size) / noise.image_px
            rows = [
                (keys[person, slot], row)
                for slot, row in zip(tracklet.slots.tolist(), tracklet.rows.tolist(), strict=True)
                if (person, slot) in keys
            ]
            if not rows:
                continue
            place, row = np.array(rows).T
            scores = series.scores[row]
            pixels[tracklet.camera, place] = np.where(
                (scores >= MIN_SCORE)[..., None], series.keypoints_px[row], np.nan
            )
            sigma[tracklet.camera, place] = noise.of(scores, scale)
    people = np.array(list(keys), dtype=np.int64).reshape(-1, 2)
    return Joints(
        pixels.reshape(len(recording.rig), -1, 2),
        sigma.reshape(len(recording.rig), -1),
        people[:, 0].repeat(num_joints),
        people[:, 1].repeat(num_joints),
        np.tile(np.arange(num_joints), len(keys)),
    )


def match_people(
    recording: Recording, noise: Noise, rig: Rig, most_sigmas: float = DOUBTED_SIGMAS
) -> Joints:
    """Match the people of a recording across views by a rig that is known, but may be off.

    Args:
        recording: detections.
        noise: what scores promise.
        rig: the calibration to match by.
        most_sigmas: distance to the epipolar line up to which a joint may agree, between cameras
            that are off.
    """
    seen = observe_people(recording, noise)
    everyone = np.ones(len(rig), dtype=bool)
    return _rematch(recording, noise, seen, rig, everyone, most_sigmas, FINE_SIGMAS[0])[0]


def _from_nothing(
    recording: Recording,
    noise: Noise,
    seen: Seen,
    focal: Floats,
    progress: Progress,
) -> PeopleRig | None:
    pairs = list(combinations(range(len(recording.rig)), 2))
    evidences: list[Evidence] = []
    for number, (a, b) in enumerate(pairs):
        found = pair_by_essential(seen, a, b)
        if found is not None:
            evidences.append(found[1])
        progress("pairs of cameras", number + 1, len(pairs))
    joints = gather(recording, noise, seen, group(seen, evidences))
    if not len(joints.slot):
        return None
    home = Rig(tuple(placed(c, np.eye(3), np.zeros(3)) for c in recording.rig.cameras))
    poses = pair_poses(home, joints.keypoints_px, joints.sigma_px)
    solved = solve_points(home, joints.keypoints_px, joints.sigma_px, poses, focal)
    if solved is None:
        return None
    return _finish(recording, noise, seen, solved.adjusted.rig, solved.placed, focal, progress)


def _from_start(
    recording: Recording,
    noise: Noise,
    seen: Seen,
    start: Rig,
    focal: Floats,
    progress: Progress,
) -> PeopleRig | None:
    everyone = np.ones(len(start), dtype=bool)
    current = start
    for number, tolerance in enumerate(ROUGH_SIGMAS):
        joints, _ = _rematch(recording, noise, seen, current, everyone, tolerance)
        solved = adjust_all(current, joints.keypoints_px, joints.sigma_px, everyone, focal)
        if solved is None:
            return None
        current = solved.adjusted.rig
        progress("rough matches", number + 1, len(ROUGH_SIGMAS))
    return _finish(recording, noise, seen, current, everyone, focal, progress)


def _rematch(
    recording: Recording,
    noise: Noise,
    seen: Seen,
    rig: Rig,
    done: NDArray[np.bool_],
    tolerance: float,
    least: float | None = None,
) -> tuple[Joints, int]:
    evidences = []
    for a, b in combinations(np.flatnonzero(done).tolist(), 2):
        first, second = rig.cameras[a], rig.cameras[b]
        R = second.R @ first.R.T
        t = second.t - R @ first.t
        length = float(np.linalg.norm(t))
        if length > 0:
            evidences.append(pair_by_rig(seen, a, b, R, t / length, tolerance, least))
    groups = group(seen, evidences)
    return gather(recording, noise, seen, groups), len(groups)


def _finish(
    recording: Recording,
    noise: Noise,
    seen: Seen,
    rig: Rig,
    done: NDArray[np.bool_],
    focal: Floats,
    progress: Progress,
) -> PeopleRig | None:
    """Match people again with the current rig, and adjust again."""
    best: PeopleRig | None = None
    for number, tolerance in enumerate(FINE_SIGMAS):
        joints, people = _rematch(recording, noise, seen, rig, done, tolerance)
        solved = adjust_all(
            rig, joints.keypoints_px, joints.sigma_px, done, focal, most_points=FINAL_POINTS
        )
        if solved is None:
            return best
        rig = solved.adjusted.rig
        size = np.linalg.norm(solved.adjusted.residuals, axis=-1)
        inliers = float((size[np.isfinite(size)] < 3.0).mean())
        best = PeopleRig(solved, joints, people, inliers)
        progress("adjusting", number + 1, len(FINE_SIGMAS))
    return best
