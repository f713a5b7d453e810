"""Orders to cameras: the mode of each in a slot, and whether an order can arrive in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock, SlotTimes
from e3pose.edge.camera_state import Turn
from e3pose.edge.inbox import Inbox
from e3pose.edge.send_queue import SendQueue
from e3pose.model.blind_slot import blind_cause
from e3pose.model.expected import ExpectedView
from e3pose.wire import topics
from e3pose.wire.codec import encode
from e3pose.wire.expected import packed_expected
from e3pose.wire.messages import CameraMode, Order


@dataclass(slots=True, eq=False)
class Orders:
    """The orders of an edge, and when they were sent; for one thread.

    Attributes:
        site: name of the site.
        camera_ids: of the rig.
        idle_modes: what each camera does in slots without an order.
        session: of the edge.
        queue: where orders go.
        clock: the edge's.
        inbox: has the states of the cameras, also who sleeps by order.
        no_choice: by slot, why no camera could be selected for it; only such slots.
    """

    site: str
    camera_ids: Sequence[str]
    idle_modes: Sequence[CameraMode]
    session: int
    queue: SendQueue
    clock: Clock
    inbox: Inbox
    no_choice: dict[int, str] = field(default_factory=dict)
    _sent_ns: dict[int, int] = field(default_factory=dict)
    _topics: list[str] = field(init=False)
    _until: NDArray[np.int64] = field(init=False)  # by the newest orders

    def __post_init__(self) -> None:
        self._until = np.zeros(len(self.camera_ids), dtype=np.int64)
        self._topics = [topics.of_order(self.site, camera_id) for camera_id in self.camera_ids]

    def give(
        self,
        times: SlotTimes,
        slot: int,
        decision: NDArray[np.bool_],
        lead: int,
        expected: Sequence[ExpectedView] | None = None,
        no_choice: str = "",
        asleep_until: NDArray[np.int64] | None = None,
    ) -> None:
        """Send every camera its order for a slot.

        Args:
            times: of the slots.
            slot: which.
            decision: `(num_cameras,)` selected cameras.
            lead: slots from the one that was decided from to this one.
            expected: `(num_cameras,)` expected view of each active camera; None for full-frame
                detection.
            no_choice: why no camera could be selected; empty if one could.
            asleep_until: `(num_cameras,)` the slot from which each is to be awake; None: all are.
        """
        if asleep_until is not None:
            self._until = self.inbox.order_sleep(times, asleep_until, slot, lead)
        if no_choice:
            self.no_choice[slot] = no_choice
        self._sent_ns[slot] = self.clock.now_ns()
        views = [None] * len(self.camera_ids) if expected is None else expected
        active = decision & (self._until <= slot)
        payloads = {
            topic: self._order(times, slot, camera, bool(active[camera]), lead, view)
            for camera, (topic, view) in enumerate(zip(self._topics, views, strict=True))
        }
        self.queue.put_all(payloads, slot)

    def give_early(self, times: SlotTimes, slot: int, camera: int, ahead: int) -> None:
        """Order one camera ahead of the others, for a trial with a longer lead."""
        payload = self._order(times, slot + ahead, camera, active=True, lead=ahead)
        self.queue.put_all({self._topics[camera]: payload}, slot + ahead)

    def _order(
        self,
        times: SlotTimes,
        slot: int,
        camera: int,
        active: bool,
        lead: int,
        expected: ExpectedView | None = None,
    ) -> bytes:
        expected_px, reach_px = packed_expected(expected if active else None)
        return encode(
            Order(
                camera_id=self.camera_ids[camera],
                slot=slot,
                active=active,
                idle_mode=self.idle_modes[camera],
                origin_edge_ns=times.origin_ns,
                interval_ns=times.interval_ns,
                sent_edge_ns=self.clock.now_ns(),
                session=self.session,
                lead=lead,
                expected_px=expected_px,
                reach_px=reach_px,
                asleep_until=int(self._until[camera]),
                wake_s=self.inbox.cameras[camera].early_s,
            )
        )

    def in_time(self, times: SlotTimes, slot: int) -> bool:
        """Return whether the orders for a slot were sent before it began.

        A late order is no reason to wait for a view, nor to consider its camera dead.
        """
        begin_ns = times.begin_ns(slot)
        return self._sent_ns.get(slot, begin_ns + 1) <= begin_ns

    def why_blind(
        self,
        times: SlotTimes,
        slot: int,
        decided: NDArray[np.bool_],
        turn: Turn,
        views_late: NDArray[np.bool_],
    ) -> str:
        """Return why a slot without a view is blind; see `blind_slot.blind_cause`."""
        return blind_cause(
            decided,
            turn.expected,
            arrived=False,
            no_choice=self.no_choice.get(slot, ""),
            in_time=self.in_time(times, slot),
            orders_late=turn.orders_late,
            views_late=views_late,
        )

    def forget_before(self, slot: int) -> None:
        """Drop the send times of slots that are over."""
        for kept in (self._sent_ns, self.no_choice):
            for old in [s for s in kept if s < slot]:
                del kept[old]
