"""Receive, check and sort the messages of cameras."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import msgspec
import numpy as np

from e3pose.base.arrays import Flags, Integers
from e3pose.base.clock import Clock, SlotTimes
from e3pose.base.errors import InputError
from e3pose.edge.camera_state import (
    NEAR_S,
    CameraState,
    State,
    flooding,
    standing,
    with_excused_wake,
    with_heartbeat,
    with_hello,
    with_invalid_message,
    with_message,
    with_order_to_sleep,
    with_presence,
)
from e3pose.edge.gather import Arrival, Gather
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton, convert
from e3pose.wire import topics
from e3pose.wire.arrays import poses_2d
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import RESTING, ClockAnswer, ClockQuestion, Heartbeat, Hello, View
from e3pose.wire.transport import Transport

Sent = TypeVar("Sent", View, Hello, Heartbeat, ClockQuestion)

PAUSED = "paused"  # a problem, so that the camera is not selected
BEAT_S = 0.2  # heartbeats that come sooner after the one before say nothing new of energy and delay
FLOOD_WRONG = 64  # one in so many unread messages of a flood counts as invalid


@dataclass(eq=False)
class Inbox:
    """The receiving side of an edge: one short callback per topic.

    Attributes:
        site: name of the site.
        rig: the cameras; messages of others are counted and ignored.
        joints: of the edge's skeleton.
        interval_s: seconds per slot.
        gather: where views go.
        clock: the edge's.
        on_beat: called with every heartbeat.
        paused: returns the cameras that operators paused.
        not_admitted: why cameras without a valid certificate cannot join, by camera id; replaced
            whole.
        wakes_s: `(num_cameras,)` configured times to wake; empty where none are.
        known: see `camera_state.standing`.
        cameras: their states, in the order of the rig; replaced whole: readers need no lock.
        delays: cameras and the delays of orders that they measured, seconds; to be taken.
        overslept: cameras that came back too late from a sleep, and what operators are told.
        unknown_senders: messages of cameras that the rig does not have.
        wrong: invalid messages.
        flooded: messages that were not read because their camera sends too many.
    """

    site: str
    rig: Rig
    joints: Sequence[str]
    interval_s: float
    gather: Gather
    clock: Clock
    on_beat: Callable[[Heartbeat], None]
    paused: Callable[[], frozenset[str]] = frozenset
    not_admitted: Mapping[str, str] = field(default_factory=dict)
    wakes_s: Sequence[float] = ()
    known: Collection[tuple[str, ...]] | None = None
    cameras: tuple[CameraState, ...] = field(init=False)
    delays: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=512))
    overslept: deque[tuple[str, str]] = field(default_factory=lambda: deque(maxlen=100))
    unknown_senders: int = 0
    wrong: int = 0
    flooded: int = 0
    _index: dict[str, int] = field(init=False)
    _topics: dict[str, int] = field(init=False)  # of all messages of cameras
    _beat_ns: list[int] = field(init=False)  # arrival of the heartbeat last passed on
    _sizes: list[tuple[int, int] | None] = field(init=False)  # required; None: not known yet
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        wakes_s = self.wakes_s or [0.0] * len(self.rig)
        self.cameras = tuple(map(CameraState.unheard, self.rig.camera_ids, wakes_s))
        self._index = {camera_id: i for i, camera_id in enumerate(self.rig.camera_ids)}
        self._topics = {
            topics.of_camera(self.site, camera_id, what): i
            for camera_id, i in self._index.items()
            for what in ("view", "hello", "heartbeat", "clock")
        }
        self._sizes = [
            camera.image_size if self.rig.placed or not camera.lens_assumed else None
            for camera in self.rig.cameras
        ]
        self._beat_ns = [-(2**62)] * len(self._index)

    def listen(self, transport: Transport) -> None:
        """Start to receive."""
        for what, receive in (
            ("view", self._view),
            ("hello", self._hello),
            ("heartbeat", self._heartbeat),
        ):
            transport.subscribe(topics.of_camera(self.site, topics.ANY, what), receive)
        transport.watch(topics.of_camera(self.site, topics.ANY, "alive"), self._presence)
        transport.answer(topics.of_camera(self.site, topics.ANY, "clock"), self._clock)

    def standings(self, cameras: Iterable[int] | None = None) -> list[tuple[State, str]]:
        """Return the states of some cameras by their messages, and why they cannot be selected."""
        paused, states, now_ns = self.paused(), self.cameras, self.clock.now_ns()
        shut_out, found = self.not_admitted, list[tuple[State, str]]()
        for index in range(len(states)) if cameras is None else cameras:
            camera = states[index]
            if camera.camera_id in paused:
                found.append((State.BARRED, PAUSED))
            elif why := shut_out.get(camera.camera_id):
                found.append((State.BARRED, why))
            else:
                found.append(standing(camera, self.joints, self._sizes[index], now_ns, self.known))
        return found

    def states(self) -> Integers:
        """Return `(num_cameras,)`: the `State` of each camera by its messages."""
        return np.array([state for state, _ in self.standings()])

    def problems(self) -> list[str]:
        """Return for each camera why it cannot be selected; empty if it can."""
        return [why for _, why in self.standings()]

    def order_sleep(
        self, times: SlotTimes, asleep_until: Integers, slot: int, lead: int
    ) -> Integers:
        """Return the ends of the sleeps that the orders of a slot contain.

        Args:
            times: of the slots.
            asleep_until: `(num_cameras,)` slots as decided; at most `slot` to be awake.
            slot: of the orders.
            lead: slots from the one that orders are made from to theirs.
        """
        if not asleep_until.any():
            return asleep_until
        until = np.where(self.can_sleep() & (asleep_until > slot), asleep_until, 0)
        for index in np.flatnonzero(until).tolist():
            slept = int(until[index])
            due_ns = times.begin_ns(slept - lead)
            self._change(index, partial(with_order_to_sleep, until=slept, due_ns=due_ns))
        return until

    def excuse(self) -> None:
        """Ignore the next wakes, as the edge was away or behind."""
        for index in range(len(self.rig)):
            self._change(index, with_excused_wake)

    def can_sleep(self) -> Flags:
        """Return `(num_cameras,)`: cameras that may be ordered to sleep, or were before."""
        return np.array([camera.can_sleep for camera in self.cameras], dtype=bool)

    def wait_for_cameras(
        self, stopping: threading.Event, start_wait_s: float, least: int = 2, resumes: bool = False
    ) -> bool:
        """Wait for all awake cameras, or a while after a few; return whether to start.

        Args:
            stopping: ends the wait.
            start_wait_s: how long to wait for the rest once a few are there.
            least: how many these are.
            resumes: whether any will do, or that all sleep.
        """
        few_ns: int | None = None
        while not stopping.is_set():
            now_ns, states = self.clock.now_ns(), self.states()
            there = (states == State.READY) | (states == State.ASLEEP)
            few_ns = (few_ns or now_ns) if there.sum() >= min(least, len(there)) else None
            waited = few_ns is not None and now_ns - few_ns >= start_wait_s * 1e9
            if there.all() or waited or (resumes and there.any()):
                return True
            self.clock.wait(stopping, now_ns + 50_000_000)
        return False

    def orders_late(self) -> Flags:
        """Return `(num_cameras,)`: cameras whose last heartbeat counted late orders."""
        return np.array([camera.orders_late for camera in self.cameras], dtype=bool)

    def _change(self, index: int, change: Callable[[CameraState], CameraState]) -> CameraState:
        with self._lock:
            state = change(self.cameras[index])
            self.cameras = (*self.cameras[:index], state, *self.cameras[index + 1 :])
            return state

    def _camera(self, topic: str) -> int | None:
        """Return the index of the camera that published on a topic; None to ignore the message.

        This runs for every message of a flood, so it does little before the rate is checked.
        """
        index = self._topics.get(topic)
        if index is None:
            self._count_unknown()
            return None
        now_ns = self.clock.now_ns()
        if not flooding(self.cameras[index], 1 / self.interval_s, now_ns):
            self._change(index, partial(with_message, now_ns=now_ns))
            return index
        with self._lock:
            self.flooded += 1
            counts = self.flooded % FLOOD_WRONG == 0
        if counts:
            self._change(index, lambda state: with_invalid_message(state, "too many", now_ns))
        return None

    def _count_unknown(self) -> None:
        with self._lock:  # several threads of the transport count
            self.unknown_senders += 1

    def _refuse(self, index: int, error: InputError) -> None:
        now_ns = self.clock.now_ns()
        with self._lock:
            self.wrong += 1
        self._change(index, lambda state: with_invalid_message(state, str(error), now_ns))

    def _message(self, topic: str, payload: bytes, kind: type[Sent]) -> tuple[int, Sent] | None:
        """Return the index of the camera that published, and its message; None to ignore it."""
        index = self._camera(topic)
        if index is None:
            return None
        camera_id = self.rig.camera_ids[index]
        try:
            message = decode(payload, kind, camera_id)
            if (named := message.camera_id) != camera_id:
                raise InputError(f"{camera_id}: message: found one of {named}, expected its own")
        except InputError as error:
            self._refuse(index, error)
            return None
        return index, message

    def _view(self, topic: str, payload: bytes) -> None:
        arrived_ns = self.clock.now_ns()
        if (found := self._message(topic, payload, View)) is None:
            return
        index, view = found
        hello = self.cameras[index].hello
        joints = tuple(self.joints) if hello is None else hello.joints
        try:
            if view.scores.shape[1] != len(joints):
                raise InputError(
                    f"{view.camera_id}: view: found {view.scores.shape[1]} joints, "
                    f"expected {len(joints)}"
                )
            poses = _with_joints(poses_2d(view), joints, tuple(self.joints))
        except InputError as error:
            self._refuse(index, error)
            return
        captured_ns = near(view.captured_edge_ns, arrived_ns)
        self.gather.add(view.slot, index, Arrival(poses, captured_ns, arrived_ns))

    def _hello(self, topic: str, payload: bytes) -> None:
        if (found := self._message(topic, payload, Hello)) is None:
            return
        index, hello = found
        now_ns = self.clock.now_ns()
        self._change(index, lambda state: with_hello(state, hello, now_ns))

    def _heartbeat(self, topic: str, payload: bytes) -> None:
        if (found := self._message(topic, payload, Heartbeat)) is None:
            return
        index, beat = found
        now_ns = self.clock.now_ns()
        beat = msgspec.structs.replace(beat, sent_edge_ns=near(beat.sent_edge_ns, now_ns))
        camera = self._change(index, lambda state: with_heartbeat(state, beat, now_ns))
        if camera.overslept_s:
            late_s, early_s = camera.overslept_s, camera.wake.early_s
            said = f"overslept by {late_s:.1f} s, woken {early_s:.1f} s early from now"
            self.overslept.append((camera.camera_id, f"{self.rig.titles[camera.camera_id]} {said}"))
        last = beat.ends or beat.mode in RESTING
        if now_ns - self._beat_ns[index] < BEAT_S * 1e9 and not last:
            return
        self._beat_ns[index] = now_ns
        if beat.order_delay_ns > 0:
            self.delays.append((index, beat.order_delay_ns / 1e9))
        self.on_beat(beat)

    def _presence(self, topic: str, there: bool) -> None:
        try:
            index = self._index.get(topics.sender(topic))
        except InputError:
            index = None
        if index is None:
            self._count_unknown()
            return
        now_ns = self.clock.now_ns()
        self._change(index, lambda state: with_presence(state, there, now_ns))
        self.gather.wake()

    def _clock(self, topic: str, payload: bytes) -> bytes | None:
        received_ns = self.clock.now_ns()
        if (found := self._message(topic, payload, ClockQuestion)) is None:
            return None
        return encode(ClockAnswer(found[1].sent_ns, received_ns, self.clock.now_ns()))


def near(stated_ns: int, now_ns: int) -> int:
    """Return a time that a camera states, moved to within `NEAR_S` of the edge's time."""
    near_ns = round(NEAR_S * 1e9)
    return min(max(stated_ns, now_ns - near_ns), now_ns + near_ns)


def _with_joints(poses: Poses2D, found: tuple[str, ...], wanted: tuple[str, ...]) -> Poses2D:
    """Return poses with the joints of the edge's skeleton, from any detector."""
    if found == wanted:
        return poses
    source, target = Skeleton("", found, ()), Skeleton("", wanted, ())
    keypoints_px, scores = convert(poses.keypoints_px, poses.scores, source, target)
    return Poses2D(keypoints_px, scores, poses.unchanged_s)
