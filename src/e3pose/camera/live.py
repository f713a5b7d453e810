"""The camera node: capture, detect, send and receive, each on its own thread.

    source -> capture -> [newest frame] -> detect -> [newest view] -> send ~~~> edge
                 ^---------- schedule <- receive <~~~ orders

The network stays loaded in every mode, so that a camera changes its mode within a slot. Between
the threads is room for one frame and one view: a slow detector skips frames, and never falls
behind. A camera asleep has closed its source and sends nothing; see `sleep`.
"""

from __future__ import annotations

import random
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

from e3pose.base.clock import Clock
from e3pose.base.errors import Fault, InputError
from e3pose.base.threads import ThreadGroup
from e3pose.camera.base import (
    AskedSource,
    LiveDetector,
    LiveFrame,
    LiveSource,
    OnDemandSource,
    SteeredSource,
)
from e3pose.camera.base import NodeSettings as NodeSettings
from e3pose.camera.frame_rate import FrameRate
from e3pose.camera.gate import Gate
from e3pose.camera.pictures import Pictures
from e3pose.camera.schedule import Schedule, slot_of_frame, take_order
from e3pose.camera.sleep import LEAST_SUSPEND_S, Suspend
from e3pose.camera.status import CameraCounts, heartbeat_message, hello_message, view_message
from e3pose.camera.video_recorder import VideoRecorder
from e3pose.detectors.focus import uses_feedback
from e3pose.energy.activity import ModeClock
from e3pose.model.expected import ExpectedView
from e3pose.wire import topics
from e3pose.wire.clock_exchange import exchange_time
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import Activity, Heartbeat, Order, View
from e3pose.wire.offset import OffsetEstimate, take_in
from e3pose.wire.transport import Transport

Thing = TypeVar("Thing")


class Box(Generic[Thing]):
    """A queue of one item: a newer one replaces it, and replaced ones are counted.

    Attributes:
        dropped: things that a newer one replaced.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._thing: Thing | None = None
        self._closed = self._dealing = False
        self._change = threading.Condition()

    @property
    def busy(self) -> bool:
        """Whether something is in it, or its taker has not come back yet."""
        return self._thing is not None or self._dealing

    def put(self, thing: Thing) -> None:
        """Put an item into the box, replacing one that was not taken."""
        with self._change:
            self.dropped += self._thing is not None
            self._thing = thing
            self._change.notify()

    def take(self) -> Thing | None:
        """Wait for a thing and take it; None once the box is closed."""
        with self._change:
            self._dealing = False
            while self._thing is None and not self._closed:
                self._change.wait()
            self._dealing = True
            thing, self._thing = self._thing, None
            return None if self._closed else thing

    def close(self) -> None:
        """Wake up all waiting threads."""
        with self._change:
            self._closed = True
            self._change.notify_all()


class ProcessorTime:
    """Seconds of all threads since the camera began to capture, and what part of them looking took.

    What the capture thread takes while the network runs belongs to capturing.
    """

    def __init__(self) -> None:
        """Begin."""
        self._begun_ns = time.process_time_ns()
        self._look_ns = self._capture_ns = 0

    @property
    def total_s(self) -> float:
        """Seconds so far."""
        return (time.process_time_ns() - self._begun_ns) / 1e9

    @property
    def look_s(self) -> float:
        """Seconds that looking took so far."""
        return self._look_ns / 1e9

    def capturing(self) -> None:
        """Note what the capture thread took so far; call it on that thread."""
        self._capture_ns = time.thread_time_ns()

    @contextmanager
    def looking(self) -> Iterator[None]:
        """Count what the program takes meanwhile as looking, but for the capture thread."""
        begun_ns, capture_ns = time.process_time_ns(), self._capture_ns
        try:
            yield
        finally:
            took_ns = time.process_time_ns() - begun_ns - (self._capture_ns - capture_ns)
            self._look_ns += max(took_ns, 0)


# What a camera has spent, time and energy of one moment: that at which a slot begins.
#
# A heartbeat is made between two slots and two looks, as nobody knows how much of a look is drawn
# in the middle of one, and not always after as many: in turns, each would hold the same share of
# looks.

PAUSE_NS = 450_000_000  # from heartbeat to heartbeat on average, without the wait for a slot
SPREAD = 0.2
SLOT_WAIT_S = 0.2  # at most, for a slot to begin
WAITS = 3  # of these at most, while a look goes on


def pause_ns(draw: float) -> int:
    """Return how long to wait before the next heartbeat.

    Args:
        draw: a random number in [0, 1).
    """
    return round(PAUSE_NS * (1 + SPREAD * (2 * draw - 1)))


class Spending:
    """Takes what a camera spent for one thread, as another one says that a slot begins.

    Attributes:
        told: cleared while a slot is waited for.
    """

    def __init__(
        self,
        modes: ModeClock,
        meter: Callable[[Activity], dict[str, Any]],
        looks: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin.

        Args:
            modes: the time in each mode.
            meter: the power fields of a heartbeat, and those of time if it took them itself.
            looks: whether a look goes on.
        """
        self._modes, self._meter, self._looks = modes, meter, looks
        self.told = threading.Event()
        self.told.set()
        self._taken: deque[dict[str, Any]] = deque(maxlen=1)

    def now(self) -> dict[str, Any]:
        """Return the fields of a heartbeat on mode, time, power and energy."""
        times = self._modes.times()
        return {**times.fields(), **self._meter(times.mode)}

    def begin_slot(self, active: bool) -> None:
        """Take times and energy so far, if somebody waits for them; call it before a slot's look.

        Args:
            active: whether the camera is to look: what it does from now on.
        """
        if not self.told.is_set() and not self._looks():
            self._taken.append({**self.now(), **({"mode": "active"} if active else {})})
            self.told.set()

    def by_next_slot(self) -> dict[str, Any]:
        """Return times and energy at the next slot's begin; the present ones if none is near."""
        self._taken.clear()
        self.told.clear()
        for _ in range(WAITS):
            if self.told.wait(SLOT_WAIT_S) or not self._looks():
                break
        self.told.set()
        return self._taken.pop() if self._taken else self.now()


HELLO_EVERY = 4  # heartbeats
REOPEN_S = 1.0  # after a source failed
SOURCE_WAIT_NS = 100_000_000
SLEEP_STEP_NS = 200_000_000  # how soon a camera asleep follows an order to wake
MISSED_FRAMES = 3  # a film that is played slowly has more than a second between two frames


SAME_NS = 5_000_000_000  # of one picture, before it is reported
SAME_EVERY_NS = 500_000_000  # comparing takes a thousandth of a core then


class Repeats:
    """Notices a source that sends one picture again and again, as one does whose sensor hangs.

    Two pictures of a still room differ by the sensor's noise. A source that is closed between two
    pictures may begin with an old one: a picture must come often as well as for long.
    """

    def __init__(self) -> None:
        """Begin."""
        self._mark, self._since_ns, self._next_ns, self._count = -1, 0, 0, 0
        self._problem = ""

    def problem(self, frame: LiveFrame) -> str:
        """Return the problem of a source whose newest frame this is; empty for none."""
        now_ns = frame.captured_ns
        if frame.mark is None or (now_ns < self._next_ns and not self._problem):
            return self._problem
        mark, self._next_ns, self._count = frame.mark(), now_ns + SAME_EVERY_NS, self._count + 1
        if mark != self._mark:
            self._mark, self._since_ns, self._count, self._problem = mark, now_ns, 0, ""
        same_ns = now_ns - self._since_ns
        if same_ns >= SAME_NS and self._count >= SAME_NS // SAME_EVERY_NS and not self._problem:
            self._problem = f"the same picture for {same_ns / 1e9:.0f} s"
        return self._problem


class Stuck(Fault):
    """A source or a network never answers: its thread ends with the program alone."""


STUCK_S = 30.0  # of one call of a source or a network, after which a camera gives it up
LOOK_S = 1.0  # between two looks at most: what is longer is a program that was stopped


class Calls:
    """Knows which library a thread of a camera waits for, and for how long it has."""

    def __init__(self) -> None:
        """Begin; nobody waits."""
        self._now: dict[str, object] = {}  # a call of each thing, while it lasts
        self._seen: dict[str, tuple[object, float]] = {}  # the call seen last, seconds since then
        self._looked_s = time.monotonic()

    @contextmanager
    def of(self, thing: str) -> Iterator[None]:
        """Count the time of a call."""
        self._now[thing] = object()
        try:
            yield
        finally:
            del self._now[thing]

    def stuck(self) -> str:
        """Return the part that has not answered for `STUCK_S`, if any; call it all the time."""
        now_s = time.monotonic()
        passed_s, self._looked_s = min(now_s - self._looked_s, LOOK_S), now_s
        for thing, call in list(self._now.items()):
            before, waited_s = self._seen.get(thing, (None, 0.0))
            waited_s = waited_s + passed_s if call is before else 0.0
            self._seen[thing] = call, waited_s
            if waited_s > STUCK_S:
                return thing
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    frame: LiveFrame
    slot: int
    edge_ns: int
    came_ns: int  # by the camera's clock
    interval_ns: int
    expected: ExpectedView | None = None


class CameraNode:
    """Runs one camera until stopped. Use as a context manager, or `start` and `stop` it."""

    def __init__(
        self,
        settings: NodeSettings,
        source: LiveSource,
        detector: LiveDetector | None,
        transport: Transport,
        clock: Clock,
        meter: Callable[[Activity], dict[str, Any]] = lambda mode: {},
        report: Callable[[str], None] = lambda line: None,
        pictures: Pictures | None = None,
        recorder: VideoRecorder | None = None,
        suspend: Suspend | None = None,
        modes: ModeClock | None = None,
        processor: ProcessorTime | None = None,
    ) -> None:
        """Create a camera with a loaded detector, or with a source that detects.

        Args:
            settings: of the camera.
            source: its frames; the node opens and closes it.
            detector: its network; None where each frame of the source has its poses.
            transport: how to reach the edge; the node closes it.
            clock: of this machine.
            meter: the power fields of a heartbeat (`power_w`, `energy_j`, `measured`, ...), and
                those of the time in each mode, if it took them at the moment of its reading.
            report: called with messages for operators.
            pictures: sends operators small pictures; None refuses them.
            recorder: writes videos; the node closes it.
            suspend: suspends the machine while the camera sleeps; None for its program alone.
            modes: counts what the camera does; None for one of its own.
            processor: takes the processor time of its looks; None for a program of its own.
        """
        self.pictures, self.recorder, self._suspend = pictures, recorder, suspend
        self.settings, self.source, self.detector = settings, source, detector
        self.transport, self.clock, self._report = transport, clock, report
        self.session = random.SystemRandom().randrange(1, 2**53)
        self.schedule, self.offset, self.counts = Schedule(), OffsetEstimate(), CameraCounts()
        self.problem, self.edge_there = "", False
        self.modes = modes or ModeClock(clock.now_ns)
        self._frames: Box[_Seen] = Box()
        self._views: Box[View] = Box()
        self._order = threading.Event()  # set by each order: a sleeping source may have to wake
        self._awake = threading.Event()  # cleared while nothing is to be sent
        self._awake.set()
        self._spending = Spending(self.modes, meter, lambda: self._frames.busy)
        self._lock = threading.Lock()
        self._processor = processor or ProcessorTime()
        self._image_size: tuple[int, int] | None = None  # until the first frame
        self._rate = FrameRate()
        self._gate = None if detector is None else Gate(detector, settings.gate)
        self._steered = source if isinstance(source, SteeredSource) else None
        self._on_demand = None
        if isinstance(source, OnDemandSource) and recorder is None:  # which needs all frames
            self._on_demand = source
        self._repeats, self._calls = Repeats(), Calls()
        self._noted = ""  # what the source gives other than asked for
        self._newest = (0, -1)  # session of the edge and slot of the newest frame
        self.threads = ThreadGroup(self._wake)

    def __enter__(self) -> CameraNode:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start; the edge need not be running yet."""
        site, camera_id = self.settings.site, self.settings.camera_id
        self.transport.subscribe(topics.of_order(site, camera_id), self._receive)
        self.transport.watch(topics.of_site(site, "alive"), self._see_edge)
        self.transport.be_present(topics.of_camera(site, camera_id, "alive"))
        if self.pictures is not None:
            topic = topics.of_camera(site, camera_id, "picture")
            self.transport.answer(topic, self.pictures.answer)
        for name, body in (
            ("capture", self._run_capture),
            ("detect", self._run_detect),
            ("send", self._run_send),
            ("beat", self._run_beat),
        ):
            self.threads.start(name, body)

    def stop(self) -> None:
        """Stop, and release the device."""
        self.threads.stop()
        self._wake()
        self.threads.join(timeout_s=0.5 if isinstance(self.threads.failure, Stuck) else 5.0)
        self._beat(self._spending.now(), ends=True)  # so that it is not reported as lost
        if not self.threads.alive("capture"):  # else nobody may close what it reads
            self.source.close()
        if self.recorder is not None:
            self.recorder.close()
        self.transport.close()

    def running(self) -> bool:
        """Return whether all threads are running, and no library keeps one of them for good."""
        if self.threads.running() and (thing := self._calls.stuck()):
            name, what = self.settings.camera_id, f"the {thing} has not answered for {STUCK_S:g} s"
            self.threads.fail(Stuck(f"camera {name}: {what}"))
        return self.threads.running()

    def _wake(self) -> None:
        """Let no thread wait any longer."""
        for event in (self._order, self._awake, self._spending.told):
            event.set()
        self._frames.close()
        self._views.close()

    @property
    def mode(self) -> Activity:
        """The present mode."""
        return self.modes.times().mode

    def edge_ns(self) -> int:
        """Return the estimated time of the edge."""
        return self.offset.offset.edge_ns(self.clock.now_ns())

    # Receiving, on a thread of the transport.

    def _receive(self, topic: str, payload: bytes) -> None:
        now_ns = self.edge_ns()
        try:
            order = decode(payload, Order, "edge")
        except InputError as error:
            self._report(str(error))
            return
        if order.camera_id != self.settings.camera_id or self.offset.offset.error_ns is None:
            return
        with self._lock:
            before = self.schedule
            self.schedule = take_order(before, order, now_ns)
            if self.schedule is not before and self.schedule.times is not None:
                times, counts = self.schedule.times, self.counts
                margin = times.begin_ns(order.slot) - now_ns
                counts.margin_ns = min(margin, counts.margin_ns or margin)
                made_from = times.middle_ns(order.slot - order.lead)
                counts.delay_ns = max(counts.delay_ns, now_ns - made_from)
        self._order.set()

    def _see_edge(self, topic: str, there: bool) -> None:
        """Accept orders of the next edge, even if its clock was set back."""
        self.edge_there = there
        if not there:
            with self._lock:
                self.schedule = replace(self.schedule, session=0)

    # Capturing.

    def _run_capture(self) -> None:
        is_open, frame_ns = False, self.clock.now_ns()
        while not self.threads.stopping.is_set():
            alarm_ns = self._alarm_ns()
            if alarm_ns is not None or self._may_close():
                if is_open:
                    self.source.close()
                is_open = False
                self._rest(alarm_ns)
                continue
            if not is_open:
                is_open, frame_ns = self._open(), self.clock.now_ns()
                continue
            try:
                with self._calls.of("source"):
                    if self._on_demand is not None:
                        schedule = self.schedule
                        newest = self._newest_slot(schedule.session)
                        self._on_demand.need(schedule.free_s(self.edge_ns(), newest))
                    frame = self.source.read()
                    problem = "" if frame is None else self._repeats.problem(frame)
            except InputError as error:
                self._find(str(error)[:300])
                is_open = False
                self.threads.stopping.wait(REOPEN_S)
                continue
            self._processor.capturing()
            now_ns = self.clock.now_ns()
            if frame is None:
                if now_ns - frame_ns > MISSED_FRAMES * 1e9 / self.source.fps:
                    self._find("no frames from the source")
                continue
            frame_ns = now_ns
            self._find(problem)
            self._notice()
            self._take(frame)

    def _open(self) -> bool:
        try:
            with self._calls.of("source"):
                self.source.open()
            self.modes.change("power-saving")
        except InputError as error:
            self._find(str(error)[:300])
            self.threads.stopping.wait(REOPEN_S)
            return False
        self._notice()
        return True

    def _notice(self) -> None:
        """Report what the source gives other than asked for, once."""
        if isinstance(self.source, AskedSource) and self.source.note not in ("", self._noted):
            self._noted = self.source.note
            self._report(self._noted)

    def _find(self, problem: str) -> None:
        """Report a problem with the source when it begins and when it ends, not every second."""
        if problem != self.problem:
            self.problem = problem
            self._report(problem or "frames from the source again")

    def _alarm_ns(self) -> int | None:
        """Return when to wake, edge time, from a sleep that is due or goes on; else None.

        A camera stays awake in a look, and before it has a frame and the time to say what it is.
        """
        known = self._image_size is not None and self.offset.offset.error_ns is not None
        asleep = not self._awake.is_set()
        if not (self.settings.rests and known) or (self._frames.busy and not asleep):
            return None
        return self.schedule.alarm_ns(self.edge_ns(), self.settings.wake_s, asleep)

    def _rest(self, alarm_ns: int | None) -> None:
        """Sleep until an alarm, or wait a moment for an order where there is none."""
        if alarm_ns is not None:
            self._sleep(alarm_ns)
            return
        self.modes.change("aggressive-power-saving")
        self._order.wait(SOURCE_WAIT_NS / 1e9)
        self._order.clear()

    def _sleep(self, alarm_ns: int) -> None:
        """Say that it sleeps, sleep until the alarm or an order to wake, and set the clock."""
        seconds = (alarm_ns - self.edge_ns()) / 1e9
        suspend = self._suspend if seconds >= LEAST_SUSPEND_S else None
        self.modes.change("asleep" if suspend is None else "suspended")
        self._awake.clear()
        self._beat(self._spending.now())
        if suspend is not None:
            if problem := suspend.run(int(seconds), self.threads.stopping):
                self._report(f"{problem}; asleep without suspending")
            self.modes.change("asleep")
            self.offset = OffsetEstimate()  # what counts the time may have stood still
            self._exchange(until_known=True)
        while not self.threads.stopping.is_set() and (alarm_ns := self._alarm_ns() or 0):
            step_ns = min(alarm_ns - self.edge_ns(), SLEEP_STEP_NS)
            self.clock.wait(self.threads.stopping, self.clock.now_ns() + step_ns)
        self.modes.change("power-saving")
        self._exchange()
        self._awake.set()

    def _may_close(self) -> bool:
        """Return whether the next active slot is farther away than the wake-up time.

        A camera with a problem gets no orders, and finds only by its source that it is over.
        """
        schedule = self.schedule
        if self.problem:
            return False
        if schedule.idle_mode != "aggressive-power-saving" or schedule.times is None:
            return False
        now_ns = self.edge_ns()
        due_ns = schedule.next_active_ns(now_ns)
        return due_ns is None or due_ns - now_ns > self.settings.wake_s * 1e9

    def _take(self, frame: LiveFrame) -> None:
        """Pass on a frame if it belongs to an active slot."""
        self.counts.captured += 1
        self._image_size = frame.image_size
        schedule = self.schedule
        if schedule.times is None or self.problem:
            return
        edge_ns = self.offset.offset.edge_ns(frame.captured_ns - self.settings.delay_ns)
        self._rate.add(frame.captured_ns)
        interval_ns = round(1e9 / self._rate.hz(self.source.fps))
        newest = self._newest_slot(schedule.session)
        slot = slot_of_frame(schedule.times, edge_ns, newest, interval_ns)
        if slot is None:
            return
        self._newest = (schedule.session, slot)
        active = schedule.is_active(slot)
        ahead = [later for later, on in schedule.active.items() if on and later > slot]
        if self._steered is not None and ahead:  # a change takes some frames
            self._steered.expect(schedule.expected.get(min(ahead)))
        self._spending.begin_slot(active)
        if self.recorder is not None:
            frame = frame.shared()
            self.recorder.offer(frame, edge_ns, schedule.session, slot, schedule.times)
        if active and self._is_intact(frame):
            times_ns = edge_ns, self.clock.now_ns(), schedule.times.interval_ns
            self._frames.put(_Seen(frame, slot, *times_ns, schedule.expected.get(slot)))

    def _newest_slot(self, session: int) -> int:
        """Return the newest slot of a session of the edge that has its frame; -1 for none."""
        return self._newest[1] if self._newest[0] == session else -1

    def _is_intact(self, frame: LiveFrame) -> bool:
        """Make the image of a frame ready; return whether it is intact."""
        with self._calls.of("source"):
            return frame.decode is None or frame.decode()

    # Detecting.

    def _run_detect(self) -> None:
        warned, uses = False, self._steered is not None or uses_feedback(self.detector)
        while (seen := self._frames.take()) is not None:
            self._look(seen)
            if seen.expected is not None and not uses and not warned:
                name = self.settings.detector or "the detector"
                self._report(f"feedback ignored: {name} detects in whole images only")
                warned = True
            del seen  # its picture takes some megabytes, until the next one comes

    def _look(self, seen: _Seen) -> None:
        """Pass on the poses in a frame; a network that runs makes the slot an active one."""
        begun_ns = self.clock.now_ns()
        # What is decoded on demand stays small: it is converted again for who asks for a picture.
        shared = self.pictures is not None and seen.frame.decode is None
        frame = seen.frame.shared() if shared else seen.frame
        with self._processor.looking(), self._calls.of("network"):
            begin = partial(self.modes.look, seen.came_ns, seen.interval_ns)
            if frame.poses is not None:
                begin()
                poses = frame.poses()
            elif self._gate is not None:
                poses = self._gate.look(frame.image(), seen.expected, frame.captured_ns, begin)
            else:
                raise InputError("source", "frames without poses", "poses, or a detector")
        if self.pictures is not None:
            self.pictures.offer(frame.image, seen.slot, max(seen.edge_ns, 0), frame.image_size)
        done_ns = self.clock.now_ns()
        looked = poses.unchanged_s <= 0
        self.counts.unchanged += not looked
        self.counts.detected += looked
        self.counts.focused += looked and seen.expected is not None
        times_ns = seen.edge_ns, done_ns - begun_ns, self.edge_ns()
        error_ns = self.offset.offset.error_ns or 0
        sender = self.settings.camera_id, self.session
        self._views.put(view_message(*sender, seen.slot, poses, *times_ns, error_ns))

    # Sending.

    def _run_send(self) -> None:
        topic = topics.of_camera(self.settings.site, self.settings.camera_id, "view")
        while (view := self._views.take()) is not None:
            self.transport.publish(topic, encode(view))
            self.counts.sent += 1

    def _run_beat(self) -> None:
        topic, count = topics.of_camera(self.settings.site, self.settings.camera_id, "hello"), 0
        while not self.threads.stopping.is_set():
            if not self._awake.is_set():
                self._awake.wait()
                count = 0  # says what it is at once
            image_size = self._image_size  # the hello needs it
            if image_size is not None and count % HELLO_EVERY == 0:
                fps = self._rate.hz(self.source.fps)
                hello = hello_message(self.settings, self.session, fps, image_size)
                self.transport.publish(topic, encode(hello))
            self._exchange()
            spent = self._spending.by_next_slot()
            if self._awake.is_set():  # what is said while it falls asleep would wake it again
                self._beat(spent)
            count += image_size is not None
            self.clock.wait(self.threads.stopping, self.clock.now_ns() + pause_ns(random.random()))

    def _beat(self, spent: dict[str, Any], ends: bool = False) -> None:
        if self.offset.offset.error_ns is not None:
            topic = topics.of_camera(self.settings.site, self.settings.camera_id, "heartbeat")
            self.transport.publish(topic, encode(self._heartbeat(spent, ends)))

    def _exchange(self, until_known: bool = False) -> None:
        """Ask the edge for the time, again and again until it is known if that is asked for."""
        name, report = self.settings.camera_id, self._report
        topic = topics.of_camera(self.settings.site, name, "clock")
        found = exchange_time(self.transport, topic, name, self.clock, report)
        while found is None and until_known and not self.threads.stopping.wait(SLEEP_STEP_NS / 1e9):
            found = exchange_time(self.transport, topic, name, self.clock, report)
        if found is not None:
            self.offset = take_in(self.offset, found)

    def _heartbeat(self, spent: dict[str, Any], ends: bool = False) -> Heartbeat:
        with self._lock:
            counts = replace(self.counts)
            counts.cpu_s, counts.look_cpu_s = self._processor.total_s, self._processor.look_s
            self.counts.margin_ns, self.counts.delay_ns = None, 0
        return heartbeat_message(
            self.settings.camera_id,
            self.session,
            counts,
            self.schedule,
            self.offset.offset,
            self.clock.now_ns(),
            spent,
            dropped=self._frames.dropped + self._views.dropped,
            problem=self.problem,
            ends=ends,
        )
