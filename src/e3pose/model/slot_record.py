"""The record of one slot: poses, tracks, selection and its reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.expected import ExpectedView
from e3pose.model.people import People

Selection = NDArray[np.bool_]  # (num_cameras,)


@dataclass(frozen=True, slots=True, eq=False)
class Reasons:
    """Why cameras were chosen for a slot.

    Attributes:
        slot: the slot they were chosen for.
        gain_nats: `(num_cameras,)` information a joint that each camera adds to, or would add to,
            the others that were chosen.
        price: `(num_cameras,)` what its queue asked for.
        error_m: mean distance of joints from the truth expected with the chosen cameras; NaN when
            nobody is known.
        check: the cost of rests so far, for operators; empty while that is unknown.
    """

    slot: int
    gain_nats: Floats
    price: Floats
    error_m: float
    check: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SlotRecord:
    """The record of one slot.

    Attributes:
        slot: index of the slot.
        time_s: its time since the start.
        selected: `(num_cameras,)` cameras that were ordered to detect in this slot and were online.
        arrived: `(num_cameras,)` selected cameras whose view came.
        people: as they are published.
        occlusion: `(num_cameras,)` paper eq. (4) predicted for slot + lead.
        deficit: `(num_cameras,)` queues after the decision for slot + lead.
        next_selection: `(num_cameras,)` the decision for slot + lead.
        reasons: for `next_selection`; None unless the pipeline foresees.
        stage_s: seconds spent in the estimator's stages, predict, occlusion, select.
        noise_factors: `(num_cameras,)` sigma of each camera's keypoints over what the noise file
            states; NaN where too little is seen, None of an estimator that does not learn it.
        expected: `(num_cameras,)` what each camera is expected to see in slot + lead, for those
            selected to look in part of their image; None without feedback, and where they look at
            all of it.
        blind: why no view arrived although one was due, a `blind_slot.Cause`; empty where one
            arrived, where no camera was to detect, and in replays.
        asleep_until: `(num_cameras,)` part of the decision for slot + lead: the slot from which
            each camera is awake again. One that is at most slot + lead: it is awake there.
    """

    slot: int
    time_s: float
    selected: Selection
    arrived: Selection
    people: People
    occlusion: Floats
    deficit: Floats
    next_selection: Selection
    reasons: Reasons | None = None
    stage_s: Mapping[str, float] = field(default_factory=dict)
    noise_factors: Floats | None = None
    expected: tuple[ExpectedView, ...] | None = None
    blind: str = ""
    asleep_until: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if self.asleep_until.shape != self.selected.shape:  # of a record without rests
            object.__setattr__(self, "asleep_until", np.zeros(len(self.selected), dtype=np.int64))
