"""People matched across views, as points with the pixels in which cameras see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.calibrate.same_people import Seen, group, pair_by_rig, shares_of_size
from e3pose.calibrate.tracklets import Tracklet, find_tracklets
from e3pose.model.camera import Rig
from e3pose.model.noise import SURE_SCORE, Noise
from e3pose.recording.record import Recording

DOUBTED_SIGMAS, LEAST_SIGMAS = (
    15.0,
    4.0,
)  # tolerance for a rig that may be off, and for one that fits


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

    def share_of_size(self, num_joints: int) -> float:
        """Return the median deviation of a keypoint, as a share of its person's size.

        Args:
            num_joints: points that one person has at one time.

        Returns:
            NaN where nothing was seen.
        """
        people = (len(self.keypoints_px), -1, num_joints)
        shares = shares_of_size(
            self.keypoints_px.reshape(*people, 2), self.sigma_px.reshape(people)
        )
        return float(np.median(shares)) if len(shares) else float("nan")


def observe_people(recording: Recording, noise: Noise) -> Seen:
    """Follow people in each view and take the lenses off their joints."""
    tracklets = [
        tracklet
        for index, series in enumerate(recording.views)
        for tracklet in find_tracklets(index, series, recording.fps)
    ]
    return without_lenses(recording, noise, tracklets)


def without_lenses(recording: Recording, noise: Noise, tracklets: Sequence[Tracklet]) -> Seen:
    """Take the lenses of a recording's rig off the joints of tracklets."""
    points, deviations = [], []
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        scale = max(camera.image_size) / noise.image_px
        good = series.scores >= SURE_SCORE
        points.append(camera.normalise(np.where(good[..., None], series.keypoints_px, np.nan)))
        deviations.append(noise.of(series.scores, scale) / camera.K[0, 0])
    return Seen(
        tracklets,
        [points[tracklet.camera][tracklet.rows] for tracklet in tracklets],
        [deviations[tracklet.camera][tracklet.rows] for tracklet in tracklets],
    )


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
                (scores >= SURE_SCORE)[..., None], series.keypoints_px[row], np.nan
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
    placed = replace(recording, rig=rig)
    everyone = np.ones(len(rig), dtype=bool)
    seen = observe_people(placed, noise)
    return rematch(placed, noise, seen, everyone, most_sigmas, LEAST_SIGMAS)[0]


def rematch(
    recording: Recording,
    noise: Noise,
    seen: Seen,
    done: NDArray[np.bool_],
    tolerance: float,
    least: float | None = None,
) -> tuple[Joints, int]:
    """Match people by where the recording's rig has the cameras, and count them.

    Args:
        recording: detections, with the rig to match by.
        noise: what scores promise.
        seen: tracklets, with the lenses of that rig taken off.
        done: `(num_cameras,)` which cameras are placed.
        tolerance: standard deviations to the epipolar line up to which a joint may agree.
        least: as `pair_by_rig` has it.
    """
    evidences = []
    for a, b in combinations(np.flatnonzero(done).tolist(), 2):
        first, second = recording.rig.cameras[a], recording.rig.cameras[b]
        R = second.R @ first.R.T
        t = second.t - R @ first.t
        length = float(np.linalg.norm(t))
        if length > 0:
            evidences.append(pair_by_rig(seen, a, b, R, t / length, tolerance, least))
    groups = group(seen, evidences)
    return gather(recording, noise, seen, groups), len(groups)
