"""The Protocol of a policy: the situation before a slot in, the selected cameras out."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from math import floor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.slot_record import Selection as Selection
from e3pose.select.expected_information import Foresight
from e3pose.select.stated_error import StatedError


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """Everything a policy may look at before one slot.

    Attributes:
        slot: the slot that is decided for, `lead_slots` after the newest views.
        interval_s: seconds per slot.
        online: `(num_cameras,)` reachable and allowed to be selected.
        occlusion: `(num_cameras,)` paper eq. (4) of the people predicted in 3D for `slot`.
        own_occlusion: `(num_cameras,)` the same from each camera's own 2D motion vectors; NaN
            without a view, and for policies that do not need it (`Need.OWN_BOXES`).
        unseen_slots: `(num_cameras,)` slots since each camera was last active.
        visibility: `(num_cameras, num_tracks)` share of the predicted joints inside the image.
        deficit: `(num_cameras,)` the virtual queue: activity beyond the budget so far, in slots.
        budget: `(num_cameras,)` the paper's E_n: the share of slots a camera may be active.
        price: `(num_cameras,)` cost of waking a camera: the drift of its queue, the paper's q_n
            where all cameras cost the same energy (`energy.queues.price`).
        spread: usual difference of `occlusion` between cameras, the unit of V of the paper's
            policies; 0 before any occlusion.
        foresight: expected information of each camera; None if the policy does not need it
            (`Need.FORESIGHT`).
        stated: mean error that the estimator stated in the last seconds, after the warm-up.
    """

    slot: int
    interval_s: float
    online: Selection
    occlusion: Floats
    own_occlusion: Floats
    unseen_slots: NDArray[np.int64]
    visibility: Floats
    deficit: Floats
    budget: Floats
    price: Floats
    spread: float = 0.0
    foresight: Foresight | None = None
    stated: StatedError = field(default_factory=StatedError)


class Need(Enum):
    """Requirements of a policy beyond a plain situation."""

    FORESIGHT = "what each camera is expected to tell, in `Situation.foresight`"
    OWN_BOXES = "what cameras foresee from their own boxes, in `Situation.own_occlusion`"
    SENT_BOXES = "boxes that every camera sends for every decision, which costs it WiFi"
    HELD_POSES = "poses of the slot before in slots without a camera, which are lost frames to it"


class Promise(Enum):
    """Guarantees of a policy about its selections."""

    COUNT = "exactly the cameras per slot asked for, or all that are online if they are fewer"
    BUDGET = "every camera stays within its budget in the long run"


class Policy(Protocol):
    """Decide which cameras detect in a slot, from the situation alone: policies keep no memory."""

    def select(self, situation: Situation) -> Selection:
        """Return `(num_cameras,)`: whether each camera detects in `situation.slot`."""
        ...


def selected_by(policy: Policy, situation: Situation) -> Selection:
    """Return the cameras that a policy selects.

    Raises:
        InputError: naming the policy, where it does not return one truth value for each camera.
    """
    selection: object = policy.select(situation)
    try:
        found = np.asarray(selection)
    except ValueError:  # lists of unequal length
        found = np.empty(0)
    num_cameras = len(situation.online)
    if found.shape != (num_cameras,) or found.dtype != np.bool_:
        shape = f"{type(selection).__name__} of shape {found.shape}, {found.dtype}"
        wanted = f"an array of shape ({num_cameras},), bool: one for each camera"
        raise InputError(f"policy {name_of(policy)}: select", shape, wanted)
    return found


def check_policy(policy: object) -> None:
    """Raise `InputError`, naming the policy, where it has no method `select`."""
    if not callable(getattr(policy, "select", None)):
        wanted = "a method select(situation), see docs/how-to/own-parts.md"
        raise InputError(f"policy {name_of(policy)}", f"a {type(policy).__name__}", wanted)


def name_of(policy: object) -> str:
    """Return the name of a policy for messages."""
    return getattr(policy, "__name__", type(policy).__name__)


def count_at(slot: int, num_selected: float) -> int:
    """Return how many cameras to wake in `slot` for a mean of `num_selected`, spread evenly.

    This is the queue `max(q + num_selected, 0)` served by whole cameras, written without a memory:
    over any slots in a row the total is within one camera of the mean.
    """
    return count_before(slot + 1, num_selected) - count_before(slot, num_selected)


def count_before(slot: int, num_selected: float) -> int:
    """Return how many cameras are woken in all slots before `slot`."""
    return floor(slot * num_selected + 1e-6)


def lowest(values: Floats, online: Selection, count: int, phase: int = 0) -> Selection:
    """Select the `count` online cameras of lowest value; `phase` rotates who wins a tie."""
    num_cameras = len(values)
    turn = (np.arange(num_cameras) - phase) % num_cameras
    order = np.lexsort((turn, values))
    chosen = order[online[order]][:count]
    selection = np.zeros(num_cameras, dtype=bool)
    selection[chosen] = True
    return selection
