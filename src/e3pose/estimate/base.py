"""The Protocol of an estimator: views of a slot and its own state in, people out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.model.dynamics import dynamics_of
from e3pose.model.noise import ErrorMemory
from e3pose.model.pose import Poses2D, Poses3D
from e3pose.predict.base import Prediction

STEER_SLOTS = 2  # how far ahead `Estimator.steer` needs a prediction

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
        track_ids: `(num_tracks,)` their published identities.
        state: `(num_tracks, num_joints, 6)` position in metres, velocity in metres per second.
        covariance: `(num_tracks, num_joints, 6, 6)` of `state`.
        shared: `(num_tracks, num_joints, 6, 6)` of each joint's `state` with its parent's.
        bones_m: `(num_tracks, num_bones)` lengths learned.
        bone_counts: `(num_tracks, num_bones)` slots that taught them.
        start: of the prediction.
        inflation: `(num_tracks, num_joints)` factor on the standard deviations that are published;
            NaN of tracks that are not.
        repeated_m2: `(num_tracks, num_joints, 3, 3)` the errors that views repeat, published
            besides; NaN likewise.
        lasting_m2: `(num_tracks, num_joints, 3, 3)` the same if errors last as the learned biases
            do; NaN likewise.
        excess: how much larger these biases were than usual in the last seconds, 0 or more: the
            share of the way from `repeated_m2` to `lasting_m2` that smoothers publish.
    """

    time_s: float
    tracks: NDArray[np.int64]
    track_ids: NDArray[np.int64]
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
class People:
    """The people of one slot, and their past positions.

    Attributes:
        poses: the people, world metres.
        track_ids: `(num_persons,)` their identities.
        history_m: `(num_slots, num_tracks, num_joints, 3)` oldest first, up to this slot;
            NaN where a joint was not estimated or the person was absent. The input of the
            predictor; it may have tracks that `poses` lacks.
        history_ids: `(num_tracks,)` identities of the tracks of `history_m`.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of the joints of `poses`; NaN where those
            are missing.
        measured: `(num_persons, num_joints)` whether a view of this slot measured the joint; the
            others are predicted from earlier slots, or missing.
        stage_s: seconds spent in each stage of the estimator.
        noise_factors: `(num_cameras,)` sigma of each camera's keypoints relative to the noise
            file; NaN where too little is seen, None if the estimator does not learn it.
        posterior: of all tracks, for a smoother; None if the estimator has no memory.
    """

    poses: Poses3D
    track_ids: NDArray[np.int64]
    history_m: NDArray[np.float64]
    history_ids: NDArray[np.int64]
    covariance_m2: NDArray[np.float64]
    measured: NDArray[np.bool_]
    stage_s: Mapping[str, float]
    noise_factors: NDArray[np.float64] | None = None
    posterior: Posterior | None = None

    @property
    def dynamics(self) -> NDArray[np.float64] | None:
        """`(num_persons, num_joints, 6)` see `model.dynamics`; None without a posterior."""
        if self.posterior is None:
            return None
        there = {track_id: row for row, track_id in enumerate(self.posterior.track_ids.tolist())}
        rows = [there[track_id] for track_id in self.track_ids.tolist()]
        known = self.poses.scores > 0
        found = dynamics_of(self.posterior.state[rows], self.posterior.covariance[rows])
        return np.where(known[..., None], found, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Prediction for a future slot, and the knowledge of the newest slot.

    Attributes:
        track_ids: `(num_tracks,)` all tracks, also those not yet published.
        confirmed: `(num_tracks,)` whether each is published.
        joints_m: `(num_tracks, num_joints, 3)` metres in the future slot, never missing.
        covariance: `(num_tracks, num_joints, 6, 6)` of position and velocity in the newest slot,
            metres and metres per second.
        drift_m2ps3: `(num_tracks, num_joints)` power density of the acceleration along an axis.
        velocity_lasts_s: `(num_joints,)` until a velocity is down to 1/e.
        has_memory: whether views of earlier slots add information about a later one.
        delivered: `(num_tracks, num_cameras)` 0 or more: information of a camera's recent views
            about the person, relative to a view of every joint at the best score, if all cameras
            were as sure of themselves as their mean.
        shows: `(num_tracks, num_cameras)` in [0, 1]: probability that the camera detects a person
            at the predicted place, relative to a place without obstacles.
        detection_map: `(num_cameras, num_cells, num_cells, 2)` looks at people by place, and those
            that showed them (`filter.blindness`); None without a memory.
        last_seen_s: `(num_tracks, num_cameras)` seconds since each camera detected the person; inf
            if never.
        sigma_px: `(num_cameras,)` error of a visible keypoint; as a share of its image the same of
            all cameras.
        memory: how long such errors persist.
        bias_share: mean square of the learned biases over the variance of a keypoint, of the last
            seconds: where it is large, errors last longer than `memory` says.
        unexplained: `(num_cameras,)` detections of each camera's newest view that no track
            explains, while they wait for another camera.
        unexplained_s: `(num_cameras,)` seconds since that view.
        wait_s: largest time between two views that start a track.
    """

    track_ids: NDArray[np.int64]
    confirmed: NDArray[np.bool_]
    joints_m: NDArray[np.float64]
    covariance: NDArray[np.float64]
    drift_m2ps3: NDArray[np.float64]
    velocity_lasts_s: NDArray[np.float64]
    has_memory: bool
    delivered: NDArray[np.float64]
    shows: NDArray[np.float64]
    detection_map: NDArray[np.float64] | None
    last_seen_s: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    memory: ErrorMemory
    bias_share: float
    unexplained: NDArray[np.int64]
    unexplained_s: NDArray[np.float64]
    wait_s: float

    def __len__(self) -> int:
        return len(self.track_ids)


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
    ) -> tuple[Memory, People]:
        """Return the people of a slot.

        Args:
            memory: of the slot before; it is not changed.
            views: camera index to its detections; any number of cameras, also none.
            time_s: of the slot.
            clock: seconds, for stage times only.

        Returns:
            The memory for the next slot and the people of this one.
        """
        ...

    def steer(self, memory: Memory, prediction: Prediction, interval_s: float) -> Memory:
        """Return the memory steered by a predictor, as far as it supports that.

        Args:
            memory: of the newest slot.
            prediction: from the `People.history_m` of that slot, `STEER_SLOTS` slots or more.
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
