"""The Protocol of an estimator: views of a slot and its own state in, people out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.model.noise import ErrorMemory
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.predict.base import Predictor

STEER_SLOTS = 2  # how far ahead `Estimator.steer` looks

Memory = TypeVar("Memory")


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the filter's prediction of a slot started: the slot before, steered (`steer`).

    Attributes:
        time_s: of the slot before; NaN before the first.
        tracks: `(num_before,)` ids as in `Posterior`, of the slot before.
        state: `(num_before, num_joints, 6)` with steered velocities.
        drift_share: `(num_before, num_joints)` share of the process noise that was used.
    """

    time_s: float
    tracks: NDArray[np.int64]
    state: NDArray[np.float64]
    drift_share: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """All tracks, after the views of one slot.

    Attributes:
        time_s: of the slot.
        tracks: `(num_tracks,)` internal ids, increasing, constant while a track exists.
        shown: `(num_persons,)` rows of those who are published, in their order.
        state: `(num_tracks, num_joints, 6)` position in metres, velocity in metres per second.
        covariance: `(num_tracks, num_joints, 6, 6)` of `state`.
        shared: `(num_tracks, num_joints, 6, 6)` of each joint's `state` with its parent's.
        bones_m: `(num_tracks, num_bones)` lengths learned.
        bone_counts: `(num_tracks, num_bones)` slots that taught them.
        start: of the prediction.
        inflation: `(num_persons, num_joints)` factor on the standard deviations that are published.
        repeated_m2: `(num_persons, num_joints, 3, 3)` the errors that views repeat, published
            besides.
        lasting_m2: `(num_persons, num_joints, 3, 3)` the same if errors last as the learned biases
            do.
        excess: how much larger these biases were than usual in the last seconds, 0 or more: the
            share of the way from `repeated_m2` to `lasting_m2` that smoothers publish.
    """

    time_s: float
    tracks: Integers
    shown: Integers
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    shared: NDArray[np.float64]
    bones_m: NDArray[np.float64]
    bone_counts: NDArray[np.float64]
    start: Start
    inflation: NDArray[np.float64]
    repeated_m2: NDArray[np.float64]
    lasting_m2: NDArray[np.float64]
    excess: float


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Where tracks were shown in the last slots: the input of predictors.

    Attributes:
        track_ids: `(num_tracks,)`.
        joints_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first, up to the newest
            slot; NaN where a joint was not estimated or the person was absent.
    """

    track_ids: Integers
    joints_m: Floats

    @classmethod
    def empty(cls, num_slots: int, num_joints: int) -> History:
        """Return the history of nobody, of `num_slots` slots, at least 2."""
        joints_m = np.zeros((max(num_slots, 2), 0, num_joints, 3))
        return cls(np.zeros(0, dtype=np.int64), joints_m)

    def after(self, track_ids: Integers, joints_m: Floats) -> History:
        """Return the history after another slot.

        Args:
            track_ids: `(num_tracks,)` of the slot; others are dropped.
            joints_m: `(num_tracks, num_joints, 3)` of the slot.
        """
        if track_ids.tolist() == self.track_ids.tolist():
            return History(track_ids, np.concatenate([self.joints_m[1:], joints_m[None]]))
        history_m = np.full((len(self.joints_m), *joints_m.shape), np.nan)
        _, new, old = np.intersect1d(
            track_ids, self.track_ids, assume_unique=True, return_indices=True
        )
        history_m[:-1, new] = self.joints_m[1:, old]
        history_m[-1] = joints_m
        return History(track_ids, history_m)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The estimate of one slot.

    Attributes:
        people: in the slot, as they are published.
        history: up to this slot; it may have tracks that `people` lacks.
        stage_s: seconds spent in each stage of the estimator.
        noise_factors: `(num_cameras,)` sigma of each camera's keypoints relative to the noise
            file; NaN where too little is seen, None if the estimator does not learn it.
        posterior: of all tracks, for a smoother; None if the estimator has no memory.
    """

    people: People
    history: History
    stage_s: Mapping[str, float]
    noise_factors: Floats | None = None
    posterior: Posterior | None = None


class Expected(NamedTuple):
    """People expected in a future slot, as kernels fill and take them.

    Joints are those that tell people apart, without fingers and skin.

    Attributes:
        track_ids: `(num_tracks,)` all tracks, also those not yet published.
        confirmed: `(num_tracks,)` whether each is published.
        joints_m: `(num_tracks, num_joints, 3)` metres in the future slot, never missing.
        covariance: `(num_tracks, num_joints, 6, 6)` of position and velocity in the newest slot,
            metres and metres per second.
        drift_m2ps3: `(num_tracks, num_joints)` power density of the acceleration along an axis.
        velocity_lasts_s: `(num_joints,)` until a velocity is down to 1/e.
        delivered: `(num_tracks, num_cameras)` 0 or more: information of a camera's recent views
            about the person, relative to a view of every joint at the best score, if all cameras
            were as sure of themselves as their mean.
        shows: `(num_tracks, num_cameras)` in [0, 1]: probability that the camera detects a person
            at the predicted place, relative to a place without obstacles.
        last_seen_s: `(num_tracks, num_cameras)` seconds since each camera detected the person; inf
            if never.
        sigma_px: `(num_cameras,)` error of a visible keypoint; as a share of its image the same of
            all cameras.
    """

    track_ids: Integers
    confirmed: Flags
    joints_m: Floats
    covariance: Floats
    drift_m2ps3: Floats
    velocity_lasts_s: Floats
    delivered: Floats
    shows: Floats
    last_seen_s: Floats
    sigma_px: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Prediction for a future slot, and the knowledge of the newest slot.

    Attributes:
        expected: people in the future slot.
        has_memory: whether views of earlier slots add information about a later one.
        detection_map: `(num_cameras, num_cells, num_cells, 2)` looks at people by place, and those
            that showed them (`filter.blindness`); None without a memory.
        memory: how long errors of keypoints persist.
        bias_share: mean square of the learned biases over the variance of a keypoint, of the last
            seconds: where it is large, errors last longer than `memory` says.
        unexplained: `(num_cameras,)` detections of each camera's newest view that no track
            explains, while they wait for another camera.
        unexplained_s: `(num_cameras,)` seconds since that view.
        wait_s: largest time between two views that start a track.
    """

    expected: Expected
    has_memory: bool
    detection_map: Floats | None
    memory: ErrorMemory
    bias_share: float
    unexplained: Integers
    unexplained_s: Floats
    wait_s: float


class Estimator(Protocol[Memory]):
    """Estimate people and positions. The memory is a value that only the estimator reads."""

    def begin(self) -> Memory:
        """Return the memory before the first slot."""
        ...

    def estimate(
        self,
        memory: Memory,
        views: Mapping[int, Poses2D],
        time_s: float,
        clock: Callable[[], float],
    ) -> tuple[Memory, Estimate]:
        """Estimate the people of a slot.

        Args:
            memory: of the slot before; it is not changed.
            views: camera index to its detections; any number of cameras, also none.
            time_s: of the slot.
            clock: seconds, for stage times only.

        Returns:
            The memory for the next slot and the estimate of this one.
        """
        ...

    def steer(self, memory: Memory, predictor: Predictor, interval_s: float) -> Memory:
        """Return the memory steered by a predictor, as far as it supports that.

        Args:
            memory: of the newest slot.
            predictor: of people's motion.
            interval_s: seconds per slot.
        """
        ...

    def leave_out_ids(self, memory: Memory, count: int) -> Memory:
        """Return the memory in which the next `count` track ids are skipped."""
        ...

    def forget_people(self, memory: Memory) -> Memory:
        """Return the memory without people; site parameters and ids stay."""
        ...

    def outlook(self, memory: Memory, ahead_s: float) -> Outlook:
        """Return the prediction `ahead_s` seconds after the newest slot, without new views."""
        ...
