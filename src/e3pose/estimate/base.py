"""What every estimator is: the views of a slot and its own memory in, the people out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter import Outlook as Outlook
from e3pose.estimate.filter.posterior import Posterior
from e3pose.model.pose import Poses2D, Poses3D
from e3pose.predict.base import Prediction

STEER_SLOTS = 2  # how far ahead `Estimator.steer` needs a prediction

Memory = TypeVar("Memory")


@dataclass(frozen=True, slots=True, eq=False)
class People:
    """Who is there in one slot, and where they were.

    Attributes:
        poses: the people, world metres.
        track_ids: `(num_persons,)` their identities.
        history_m: `(num_slots, num_tracks, num_joints, 3)` oldest first, the newest being this
            slot; NaN where a joint was not estimated or the person was not there. What the
            predictor is given; it may have tracks that `poses` lacks.
        history_ids: `(num_tracks,)` identities of the tracks of `history_m`.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of the joints of `poses`; NaN where those
            are missing.
        measured: `(num_persons, num_joints)` whether a view of this slot measured the joint; the
            others are carried on from earlier slots, or missing.
        stage_s: seconds spent in each stage of the estimator.
        noise_factors: `(num_cameras,)` sigma of each camera's keypoints over what the noise file
            states; NaN where too little is seen, None of an estimator that does not learn it.
        posterior: of everybody followed, for a smoother; None of an estimator without a memory.
        shifts_px: `(num_cameras, 2)` pixels right and down that every keypoint of a camera is off,
            as learned and taken off; NaN and None as of `noise_factors`.
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
    shifts_px: NDArray[np.float64] | None = None


class Estimator(Protocol[Memory]):
    """Estimate who is where. The memory is a value that the estimator alone understands."""

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
        """Take in one slot.

        Args:
            memory: what the slot before handed over; it is not changed.
            views: camera index to what it saw; any number of cameras, also none.
            time_s: of the slot.
            clock: seconds, for stage times only.

        Returns:
            The memory to hand on and the people of this slot.
        """
        ...

    def steer(self, memory: Memory, prediction: Prediction, interval_s: float) -> Memory:
        """Return the memory that expects people to move as a predictor does, as far as it can.

        Args:
            memory: of the newest slot.
            prediction: from the `People.history_m` of that slot, `STEER_SLOTS` slots or more.
            interval_s: seconds a slot.
        """
        ...

    def leave_out_ids(self, memory: Memory, count: int) -> Memory:
        """Return the memory in which the next `count` identities are never given to anybody."""
        ...

    def forget_people(self, memory: Memory) -> Memory:
        """Return the memory with nobody in it: what was learned of the site and ids stay."""
        ...

    def outlook(self, memory: Memory, ahead_s: float) -> Outlook:
        """Return what is expected `ahead_s` seconds after the newest slot, if nothing is seen."""
        ...
