"""Slots that wait for later ones, which smooth them: the same live and in a replay."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.estimate.base import Posterior
from e3pose.estimate.filter.bones import Proportions, proportions_of
from e3pose.estimate.filter.motion import places
from e3pose.estimate.filter.proportions import kept
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth.bodies import FixedLag, Smoothed
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord


@dataclass
class Delayed:
    """Records of recent slots, held until enough later slots are known.

    Attributes:
        skeleton: of the poses.
        lag_slots: how many later slots a slot waits for.
    """

    skeleton: Skeleton
    lag_slots: int
    _body: Proportions = field(init=False)
    _lag: FixedLag = field(init=False)
    _waiting: deque[SlotRecord] = field(init=False, default_factory=deque)

    def __post_init__(self) -> None:
        tree = grow(self.skeleton)
        self._body, self._lag = proportions_of(self.skeleton, tree), FixedLag(tree, self.lag_slots)

    def warm_up(self) -> None:
        """Compile or load the kernels of a slot; takes seconds the first time."""
        people, bones = (0, len(self.skeleton)), (0, len(self._body.bones))
        covariance_m2, known = np.zeros((*people, 3, 3)), np.zeros(people, dtype=bool)
        nowhere_m, lengths_m = np.zeros((*people, 3)), np.zeros(bones)
        kept(self._body, lengths_m, lengths_m, nowhere_m, covariance_m2, known)
        places(self._lag.tree, np.zeros((*people, 6)), 0.0)

    def push(self, record: SlotRecord, posterior: Posterior) -> SlotRecord | None:
        """Add the newest slot; return the one `lag_slots` before it, smoothed, once there is one.

        Args:
            record: of the slot.
            posterior: of the same slot.
        """
        self._waiting.append(record)
        late = self._lag.push(posterior)
        return None if late is None else self._smoothed(late)

    def flush(self) -> Iterator[SlotRecord]:
        """Yield the slots that still wait, smoothed by the slots after them that are known."""
        while (late := self._lag.flush()) is not None:
            yield self._smoothed(late)

    def forget(self) -> None:
        """Start again: slots that wait are given up."""
        self._lag = FixedLag(self._lag.tree, self.lag_slots)
        self._waiting.clear()

    def _smoothed(self, late: Smoothed) -> SlotRecord:
        return with_smoothed(self._waiting.popleft(), late, self._body)


def with_smoothed(record: SlotRecord, late: Smoothed, body: Proportions) -> SlotRecord:
    """Return the record of a slot with its people smoothed.

    Args:
        record: of the slot.
        late: of the same slot.
        body: the bones.
    """
    people = record.people
    joints_m, covariance_m2 = late.published(people.scores, body)
    people = replace(people, joints_m=joints_m, full_covariance_m2=covariance_m2)
    return replace(record, people=people)


def lag_slots(delay_s: float, interval_s: float) -> int:
    """Return a delay in slots, at least one.

    Args:
        delay_s: how much later smoothed poses are published; above 0.
        interval_s: of a slot.
    """
    return max(1, round(delay_s / interval_s))
