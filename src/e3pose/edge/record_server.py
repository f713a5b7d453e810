"""Record the views of all cameras of a site that needs no calibration.

All cameras are active in every slot. Nothing is computed, so late views are not a problem.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np

from e3pose.base.clock import Clock, SlotTimes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.quantities import plural
from e3pose.base.threads import ThreadGroup
from e3pose.edge.gather import Arrival, Gather
from e3pose.edge.inbox import Inbox
from e3pose.edge.orders import Orders
from e3pose.edge.processor_times import ProcessorTimes
from e3pose.edge.send_queue import SendQueue
from e3pose.model.camera import Rig
from e3pose.model.skeleton import Skeleton
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.writer import RecordingWriter
from e3pose.wire import topics
from e3pose.wire.transport import Transport

AHEAD_S = 0.6  # orders are sent so long before their slot
PATIENCE_S = 2.0  # for views, beyond the end of their slot
LONE_S = 20.0  # to wait for further cameras once one is connected
END_S = 5.0
Watch = Callable[[int, Mapping[int, Arrival]], object]  # takes a slot and its views by camera


def ignore_views(slot: int, arrivals: Mapping[int, Arrival]) -> None:
    """Watch nothing."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """Settings of one recording.

    Attributes:
        dest: the folder to make.
        site: name of the site.
        rig: its cameras, as far as known.
        skeleton: of the keypoints.
        fps: slots per second of the scene.
        pace: seconds of the scene that pass in a second.
        detector: whose noise the keypoints have; empty to use the names that cameras report.
        for_s: seconds of the scene to record; None to record until stopped.
        known: see `EdgeSettings`.
    """

    dest: Path
    site: str
    rig: Rig
    skeleton: Skeleton
    fps: float
    pace: float = 1.0
    detector: str = ""
    for_s: float | None = None
    known: Collection[tuple[str, ...]] | None = None


class RecordServer:
    """Records until stopped or for a given time. Use as a context manager."""

    def __init__(
        self, plan: RecordingPlan, transport: Transport, clock: Clock, watch: Watch = ignore_views
    ) -> None:
        """Create a recorder for a site.

        Args:
            plan: what to record.
            transport: how to reach the cameras; the server closes it.
            clock: the time.
            watch: called with each slot that is written, on the recorder's thread.
        """
        self.plan, self.transport, self.clock, self._watch = plan, transport, clock, watch
        self.interval_ns = round(1e9 / plan.fps / plan.pace)
        self.gather = Gather(len(plan.rig))
        self.processor = ProcessorTimes(plan.fps * plan.pace)
        self.inbox = Inbox(
            plan.site, plan.rig, plan.skeleton.joints, self.interval_ns / 1e9, self.gather, clock,
            self.processor.take, known=plan.known,
        )  # fmt: skip
        self.send_queue = SendQueue()
        self.orders = Orders(
            plan.site, plan.rig.camera_ids, ["power-saving"] * len(plan.rig),
            clock.now_ns() // 1000, self.send_queue, clock, self.inbox,
        )  # fmt: skip
        self.threads = ThreadGroup(self._wake)
        self.done = threading.Event()
        self.slots = 0
        self.people = np.zeros(len(plan.rig), dtype=np.int64)  # seen by each camera so far
        self.views = np.zeros(len(plan.rig), dtype=np.int64)
        self.written: Path | None = None

    def __enter__(self) -> RecordServer:
        self.inbox.listen(self.transport)
        self.transport.be_present(topics.of_site(self.plan.site, "alive"))
        self.threads.start("sending", lambda: self.send_queue.run(self._publish))
        self.threads.start("recording", self._run)
        return self

    def __exit__(self, *_: object) -> None:
        self.threads.stop()
        self.gather.wake()
        self.threads.join(END_S, without="sending")
        self.send_queue.close()
        self.threads.join(END_S)
        self.transport.close()

    def running(self) -> bool:
        """Return whether it is still recording."""
        return self.threads.running() and not self.done.is_set()

    def problems(self) -> dict[str, str]:
        """Return the cameras that cannot be recorded, with the reason."""
        problems = zip(self.plan.rig.camera_ids, self.inbox.problems(), strict=True)
        return {camera_id: why for camera_id, why in problems if why}

    def _wake(self) -> None:
        self.gather.wake()
        self.send_queue.close()

    def _publish(self, topic: str, payload: bytes, slot: int) -> None:
        self.transport.publish(topic, payload)

    def _run(self) -> None:
        if not self.inbox.wait_for_cameras(self.threads.stopping, LONE_S, least=1):
            return
        ahead = ceil(AHEAD_S * 1e9 / self.interval_ns)
        times = SlotTimes(self.clock.now_ns() + ahead * self.interval_ns, self.interval_ns)
        everyone = np.ones(len(self.plan.rig), dtype=bool)
        patience = ceil(PATIENCE_S * 1e9 / self.interval_ns)
        last = None
        if self.plan.for_s is not None:
            last = max(1, round(self.plan.for_s * self.plan.fps))
        ordered = 0
        with self._reporting(), self._writer() as writer:
            self.processor.found()  # what was before the first slot is not of the recording
            while last is None or self.slots < last:
                stopping = self.threads.stopping.is_set()
                now = times.slot_at(self.clock.now_ns())
                until = now + ahead if last is None else min(now + ahead, last - 1)
                while ordered <= until and not stopping:
                    self.orders.give(times, ordered, everyone, ahead)
                    ordered += 1
                self.orders.forget_before(self.slots)
                while self.slots < now - (0 if stopping else patience) and self.slots < ordered:
                    self._write(writer, times, self.gather.close())
                if stopping:
                    break
                writer.flush()
                self.clock.wait(self.threads.stopping, times.middle_ns(now + 1))
            writer.processor = self.processor.found()
        self.written = writer.dest if any(writer.counts.values()) else None
        self.done.set()

    @contextmanager
    def _reporting(self) -> Iterator[None]:
        """Report the slots that a recording has when the disk is full."""
        try:
            yield
        except OSError as error:
            reason = reason_of(error).lower()
            kept = "it has what was recorded until then" if self.plan.dest.exists() else "no part"
            raise InputError(
                f"{self.plan.dest}: {reason} after {plural(self.slots, 'slot')}: {kept}"
            ) from None

    def _write(
        self, writer: RecordingWriter, times: SlotTimes, arrivals: Mapping[int, Arrival]
    ) -> None:
        origin_ns = times.middle_ns(0)
        for index, arrival in arrivals.items():
            time_s = (arrival.captured_ns - origin_ns) / 1e9 * self.plan.pace
            writer.add(self.plan.rig.camera_ids[index], self.slots, time_s, arrival.poses)
            self.views[index] += 1
            self.people[index] += len(arrival.poses)
        self._watch(self.slots, arrivals)
        self.slots += 1

    def _writer(self) -> RecordingWriter:
        plan = self.plan
        hellos = [camera.hello for camera in self.inbox.cameras]
        detectors = {hello.detector for hello in hellos if hello is not None}
        detector = plan.detector or (detectors.pop() if len(detectors) == 1 else "")
        sizes = [None if hello is None else hello.image_size for hello in hellos]
        return RecordingWriter(
            plan.dest, _seen(plan.rig, sizes), plan.fps, plan.skeleton, detector,
            f"Recorded at the site {plan.site}, with all cameras active.",
        )  # fmt: skip


def _seen(rig: Rig, sizes: Sequence[tuple[int, int] | None]) -> Rig:
    """Return cameras with assumed lenses, with their real image sizes."""
    if rig.placed:
        return rig
    cameras = []
    for camera, size in zip(rig.cameras, sizes, strict=True):
        if camera.lens_assumed and size is not None:
            camera = assumed_rig({camera.camera_id: size}).cameras[0]
        cameras.append(camera)
    return replace(rig, cameras=tuple(cameras))
