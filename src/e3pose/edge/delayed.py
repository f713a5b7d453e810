"""Delayed poses: smoothed with the slots that follow."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from e3pose.edge.reports import poses_message
from e3pose.estimate.base import People
from e3pose.estimate.filter.proportions import Proportions, proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth.bodies import FixedLag
from e3pose.model.pose import Poses3D
from e3pose.model.skeleton import Skeleton
from e3pose.wire.site_messages import Poses


@dataclass
class DelayedPoses:
    """Published people of recent slots, held until enough later slots are known.

    Attributes:
        joints: names of the skeleton's joints.
        lag_slots: how many later slots a slot waits for.
    """

    joints: Sequence[str]
    lag_slots: int
    _body: Proportions = field(init=False)
    _lag: FixedLag = field(init=False)
    _waiting: deque[tuple[int, int, People]] = field(init=False)

    def __post_init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start again: slots that wait are never published."""
        tree = grow(Skeleton("", tuple(self.joints), ()))
        self._body = proportions_of(self.joints, tree)
        self._lag, self._waiting = FixedLag(tree, self.lag_slots), deque()

    def push(
        self, slot: int, time_ns: int, people: People, now_ns: Callable[[], int]
    ) -> Poses | None:
        """Add the newest slot; return the message of the one `lag_slots` before it.

        Args:
            slot: the newest.
            time_ns: when it was.
            people: as they were published.
            now_ns: the clock.
        """
        if people.posterior is None:
            return None
        self._waiting.append((slot, time_ns, people))
        late = self._lag.push(people.posterior)
        if late is None:
            return None
        slot, time_ns, shown = self._waiting.popleft()
        joints_m, covariance_m2 = late.of(
            shown.track_ids, shown.poses, shown.covariance_m2, self._body
        )
        smoothed = replace(
            shown, poses=Poses3D(joints_m, shown.poses.scores), covariance_m2=covariance_m2
        )
        return poses_message(slot, smoothed, self.joints, time_ns, now_ns())


def lag_slots(delay_s: float, interval_s: float) -> int:
    """Return a delay in slots, at least one.

    Args:
        delay_s: how much later smoothed poses are published; above 0.
        interval_s: of a slot.
    """
    return max(1, round(delay_s / interval_s))
