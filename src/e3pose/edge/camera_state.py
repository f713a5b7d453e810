"""State of every camera at the edge: whether it counts, and the reason if not.

A camera is in exactly one `State`. It follows from three values, which pure functions take and
return: `CameraState`, which messages and orders to sleep change, `Answers`, which each slot
changes, and the failure detector's `Silence`, which the loop changes. Messages come on threads of
their own: the `Inbox` keeps the first; the edge keeps the second beside the state of its loop.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.quantities import plural
from e3pose.base.records import changed
from e3pose.edge.lead import Lead, lagging
from e3pose.energy.rest_costs import alarm_s
from e3pose.model.skeleton import (
    BODY_JOINTS,
    SHIPPED,
    lacking,
    serves,
    skeleton_of_joints,
    some,
    unused,
)
from e3pose.select.failure_detector import Silence, patience
from e3pose.wire.messages import RESTING, CameraMode, Heartbeat, Hello
from e3pose.wire.site_messages import CameraStatus

CONNECTING = "connecting"  # said of a camera that is heard, before its hello
SILENT_S = 1.9  # a camera without messages for so long is offline; it sends two per second
WRONG_LIMIT = 20  # invalid messages, within the time below: it is quarantined
WRONG_S = 10.0
QUARANTINE_S = 5.0  # and readmitted after this
FLOOD_RATE = 4.0  # times the messages that a camera needs; more are not read
# A camera bounds the error of its clock by half the shortest round trip; the real error is far
# smaller. Above this limit the slot numbers of its views cannot be trusted.
CLOCK_ERROR_NS = 250_000_000
RIVAL_RETURNS = 3  # of a session after another one: a restart has none, a slow link one
RIVAL_S = 10.0  # window of these
SESSIONS = 4  # kept per camera
FROZEN_S = 5.0  # active, but without a new frame
RATE_S = (4.0, 10.0)  # in which frames are counted, at least and at most
CLOSED = ("aggressive-power-saving", *RESTING)  # modes in which a source may be closed
FROZEN_FRAMES = 3  # of a film that is played slowly, where that is longer
# Of the stated time to wake, its spread before the first wake: with less a slow board is late for
# its first order, with more a quick one idles for longer before it. Twenty wakes later it is gone.
PRIOR_SHARE = 0.5
# Wakes that the mean remembers: of fewer one odd wake moves every alarm, with more a board that
# grew slow in the heat is late for as many orders.
MEMORY_WAKES = 20
LONGEST_WAKE_S = 60.0  # a camera that comes later was away for other reasons
OVERSLEPT_S = 1.0  # late by so much is told
NEAR_S = 5.0  # times that cameras state are moved to within so much of the edge's
SHARE_ORDERS = 32  # that the share of answered orders is averaged over
RELIABLE = 0.4  # share of answered orders below which a camera is not selected, but tried
LEAST_RELIABLE = 2  # cameras, without which all are used: one sees no depth
TURN_S, EVERY_S = 1.0, 10.0  # a camera's turn to be tried, and how often it comes
MOST_DOUBLED = 2  # times that the pause between trials is doubled
AWAITED = 0.75  # share of answered orders below which slots wait for its usual time only
SILENT_ORDERS = 5  # after so many without any view, slots do not wait
NEWEST_AGES, PATIENCE = 16, 1.5  # a view usually takes so many times the longest of the newest ages
BLIND_SLOTS = 10  # in a row without any view: no camera is to blame
EXCUSED_S = 5.0  # of orders without a view, for which late orders are an excuse
SELDOM_S = 5.0  # of too few answers before it is said: the lead follows slow orders in less
ATTEMPTS = 3  # a camera given up so many times in a row is not followed by the lead
# A camera without views is reported after so many failures in a row, which take 3 s: a camera that
# is disconnected is known to be offline by then.
REPORTED_FAILURES = 3
# One with late views after it was tried again: a link may stall for the 1.5 s that the first takes.
REPORTED_LATE_FAILURES = 2
SHORT, ENOUGH = 0.9, 0.95  # delivered shares at which the warning begins and ends
DELIVERY_ORDERS = 500  # that the delivered share is averaged over
MIN_ORDERS = 50  # before which a share says little
SETTLED_S = 20.0  # after a warning before the next


class State(IntEnum):
    """State of a camera for the edge; from `ON_TRIAL` on it can be reached."""

    LEFT = 0
    ASLEEP = 1
    BARRED = 2
    ON_TRIAL = 3
    SUSPECTED = 4
    READY = 5


LEFT, ASLEEP, BARRED, ON_TRIAL, SUSPECTED, READY = State
REACHED = (ON_TRIAL, SUSPECTED, READY)
MEANINGS = {
    LEFT: "is not connected, ended, silent or overslept: gets no orders, reported as lost",
    ASLEEP: "sleeps as told: gets no orders, and is expected back",
    BARRED: "is connected, but paused, not admitted or not working: the status says why",
    ON_TRIAL: "answers too few orders: ordered now and then beside the selected cameras",
    SUSPECTED: "does not answer: given up for some seconds",
    READY: "may be selected",
}
# By event: the states that it may change, into which, and when. The tests hold that nothing else
# happens; `docs/explanation/live.md` has the table.
TRANSITIONS = {
    "seen": ((LEFT, ASLEEP, BARRED), (BARRED, *REACHED), "a message comes; at first it is barred"),
    "barred": (REACHED, (BARRED,), "it is paused, says what is wrong, or sends nonsense"),
    "left": ((ASLEEP, BARRED, *REACHED), (LEFT,), "it ends, disconnects, is silent or oversleeps"),
    "asleep": ((LEFT, BARRED, *REACHED), (ASLEEP,), "told to sleep, it says so or is silent"),
    "ordered": ((SUSPECTED, READY), (ON_TRIAL, SUSPECTED), "no view of five in a row, or of most"),
    "answered": ((ON_TRIAL, SUSPECTED), (READY,), "a view comes in time"),
    "late": ((SUSPECTED,), (READY,), "a view comes too late, or it says that its orders do"),
    "tried": ((SUSPECTED,), (READY,), "after 1 s, later 8 s, it may be ordered again"),
    "needed": ((ON_TRIAL,), (SUSPECTED, READY), "fewer than two others answer enough orders"),
    "spared": ((SUSPECTED, READY), (ON_TRIAL,), "two others answer enough orders again"),
    "forgiven": ((ON_TRIAL, SUSPECTED), (READY,), "the edge had lost its network"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class WakeTime:
    """Time from a camera's alarm to its first message, as learned; a value.

    Attributes:
        mean_s: mean.
        sd_s: standard deviation.
        wakes: that were measured.
    """

    mean_s: float
    sd_s: float
    wakes: int = 0

    @classmethod
    def stated(cls, wake_s: float) -> WakeTime:
        """Return the prior for a camera that never woke."""
        return cls(wake_s, PRIOR_SHARE * wake_s)

    @property
    def early_s(self) -> float:
        """Seconds between an alarm and the time at which the camera is needed."""
        return min(alarm_s(self.mean_s, self.sd_s), LONGEST_WAKE_S)

    def after(self, took_s: float) -> WakeTime:
        """Return the estimate after one more wake; the prior counts as one."""
        took_s = min(max(took_s, 0.0), LONGEST_WAKE_S)
        weight = 1 / min(self.wakes + 2, MEMORY_WAKES)
        off_s = took_s - self.mean_s
        variance = (1 - weight) * (self.sd_s**2 + weight * off_s**2)
        return WakeTime(self.mean_s + weight * off_s, variance**0.5, self.wakes + 1)


@dataclass(frozen=True, slots=True)
class Sleep:
    """A sleep that a camera was ordered to take; a value.

    Attributes:
        until: the slot from which it is to be awake; 0 for none.
        due_ns: when it is expected to be heard, edge time.
        early_s: how much earlier its alarm was set.
        began: whether it said that it sleeps.
        session: of the program that said so.
    """

    until: int = 0
    due_ns: int = 0
    early_s: float = 0.0
    began: bool = False
    session: int = 0


AWAKE, NO_TIME = Sleep(), WakeTime(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class CameraState:
    """The state of one camera at the edge; a value.

    Attributes:
        camera_id: of the camera.
        present: whether its program is connected.
        hello: its newest hello.
        beat: its newest heartbeat.
        heard_ns: arrival of its newest message; None before the first.
        wrong: arrival of invalid messages, newest last.
        quarantined_until_ns: until when it is quarantined because of those.
        fault: error of the newest of them.
        messages: messages of this second, for `flooding`.
        second: which second that is.
        frame_ns: when its count of frames last grew.
        restarts: of its program.
        orders_late: whether its newest heartbeat counted more late orders.
        sessions: of programs that recently sent messages in its name, newest last.
        returns: when one of them sent again after another one, newest last.
        counted: time, frames and dropped frames from which rates are measured; None in modes in
            which a camera may not film.
        frames_hz: frames per second that its source brings; None until it is measured.
        dropped_hz: frames and views per second that were replaced by newer ones; None likewise.
        sleep: that it was told to take.
        stated_wake_s: time to wake by the site file.
        wake: time to wake as learned.
        overslept_s: by how much too late its newest heartbeat ends a sleep; else 0.
    """

    camera_id: str
    present: bool = False
    hello: Hello | None = None
    beat: Heartbeat | None = None
    heard_ns: int | None = None
    wrong: tuple[int, ...] = ()
    quarantined_until_ns: int = 0
    fault: str = ""
    messages: int = 0
    second: int = 0
    frame_ns: int = 0
    restarts: int = 0
    orders_late: bool = False
    sessions: tuple[int, ...] = ()
    returns: tuple[int, ...] = ()
    counted: tuple[int, int, int] | None = None
    frames_hz: float | None = None
    dropped_hz: float | None = None
    sleep: Sleep = AWAKE
    stated_wake_s: float = 0.0
    wake: WakeTime = NO_TIME
    overslept_s: float = 0.0

    @classmethod
    def unheard(cls, camera_id: str, wake_s: float = 0.0) -> CameraState:
        """Return a camera before its first message, with its stated time to wake."""
        return cls(camera_id, stated_wake_s=wake_s, wake=WakeTime.stated(wake_s))

    @property
    def early_s(self) -> float:
        """Seconds between its alarm and the time at which it is needed."""
        return self.sleep.early_s if self.sleep.until else self.wake.early_s

    @property
    def can_sleep(self) -> bool:
        """Whether it may be ordered to sleep, or may sleep since before a restart of the edge."""
        return self.hello is None or bool(self.hello.rests)


# What happens to a camera.


def with_presence(camera: CameraState, there: bool, now_ns: int) -> CameraState:
    """Return a camera whose program connected or disconnected."""
    return replace(camera, present=there, heard_ns=now_ns if there else camera.heard_ns)


def with_message(camera: CameraState, now_ns: int) -> CameraState:
    """Return a camera that sent any message."""
    second = now_ns // 10**9
    messages = camera.messages + 1 if second == camera.second else 1
    return changed(camera, present=True, heard_ns=now_ns, messages=messages, second=second)


def with_hello(camera: CameraState, hello: Hello, now_ns: int) -> CameraState:
    """Return a camera that sent a hello."""
    camera = _with_session(replace(camera, present=True, heard_ns=now_ns), hello.session, now_ns)
    if camera.hello is None:
        return replace(camera, hello=hello, frame_ns=now_ns)
    if camera.hello.session == hello.session:
        return replace(camera, hello=hello)
    return replace(
        camera,
        hello=hello,
        beat=None,
        counted=None,
        frames_hz=None,
        dropped_hz=None,
        frame_ns=now_ns,
        restarts=camera.restarts + 1,
    )


def with_heartbeat(camera: CameraState, beat: Heartbeat, now_ns: int) -> CameraState:
    """Return a camera after a heartbeat, which may start or end a sleep."""
    before = camera.beat
    moved = before is None or beat.captured != before.captured
    closed = beat.mode in CLOSED or (before is not None and before.mode in RESTING)
    camera = _with_session(_with_rates(camera, beat, now_ns), beat.session, now_ns)
    return replace(
        _with_sleep(replace(camera, overslept_s=0.0), beat, now_ns),
        present=True,
        beat=beat,
        heard_ns=now_ns,
        frame_ns=now_ns if moved or closed else camera.frame_ns,
        orders_late=before is not None and beat.late_orders > before.late_orders,
    )


def _with_rates(camera: CameraState, beat: Heartbeat, now_ns: int) -> CameraState:
    """Return a camera with the rates of its frames, measured over some seconds."""
    if beat.mode in CLOSED:
        return replace(camera, counted=None)
    now = now_ns, beat.captured, beat.dropped
    if camera.counted is None or beat.captured < camera.counted[1]:
        return replace(camera, counted=now)
    span_s = (now_ns - camera.counted[0]) / 1e9
    if 0 <= span_s < RATE_S[0]:
        return camera
    frames_hz, dropped_hz = (
        max(here - there, 0) / span_s if span_s > 0 else None
        for here, there in zip(now[1:], camera.counted[1:], strict=True)
    )
    counted = camera.counted if 0 <= span_s < RATE_S[1] else now
    return replace(camera, counted=counted, frames_hz=frames_hz, dropped_hz=dropped_hz)


def _with_session(camera: CameraState, session: int, now_ns: int) -> CameraState:
    """Return a camera after a message of one of its programs."""
    if camera.sessions[-1:] == (session,):
        return camera
    recent = tuple(at for at in camera.returns if now_ns - at < RIVAL_S * 1e9)[-RIVAL_RETURNS:]
    if session in camera.sessions:
        recent = (*recent, now_ns)
    others = tuple(other for other in camera.sessions if other != session)
    return replace(camera, sessions=(*others, session)[-SESSIONS:], returns=recent)


def with_invalid_message(camera: CameraState, fault: str, now_ns: int) -> CameraState:
    """Return a camera that sent an invalid message."""
    recent = tuple(at for at in camera.wrong if now_ns - at < WRONG_S * 1e9)[-WRONG_LIMIT:]
    wrong = (*recent, now_ns)
    if len(wrong) < WRONG_LIMIT:
        return replace(camera, wrong=wrong, fault=fault)
    until_ns = now_ns + round(QUARANTINE_S * 1e9)
    return replace(camera, wrong=(), fault=fault, quarantined_until_ns=until_ns)


def with_order_to_sleep(camera: CameraState, until: int, due_ns: int) -> CameraState:
    """Return a camera after an order to sleep until a slot, when it is due to be heard again.

    A sleep that is cut short goes on as far as the edge knows: the order may not have been heard.
    """
    if not until or (until, due_ns) == (camera.sleep.until, camera.sleep.due_ns):
        return camera
    early_s = camera.wake.early_s
    return replace(camera, sleep=replace(camera.sleep, until=until, due_ns=due_ns, early_s=early_s))


def with_excused_wake(camera: CameraState) -> CameraState:
    """Return a camera whose next wake is not learned from, as the edge was away or behind."""
    return replace(camera, sleep=replace(camera.sleep, began=False))


def _with_sleep(camera: CameraState, beat: Heartbeat, now_ns: int) -> CameraState:
    """Return a camera after a heartbeat that starts or ends a sleep."""
    sleep = camera.sleep
    if not sleep.until:
        return camera
    if beat.mode in RESTING:
        return replace(camera, sleep=replace(sleep, began=True, session=beat.session))
    late_s = (now_ns - sleep.due_ns) / 1e9
    if sleep.began and beat.session != sleep.session:
        return replace(camera, sleep=AWAKE)  # its program was restarted: nothing of a wake
    if sleep.began:
        wake = camera.wake
        if -sleep.early_s < late_s < LONGEST_WAKE_S:  # before, it was called or started again
            wake = wake.after(late_s + sleep.early_s)
        overslept_s = late_s if late_s > OVERSLEPT_S else 0.0
        return replace(camera, sleep=AWAKE, wake=wake, overslept_s=overslept_s)
    if late_s > 0:  # it is over, and was never begun as far as is known
        return replace(camera, sleep=AWAKE, wake=_forgotten(camera))
    return camera


def _forgotten(camera: CameraState) -> WakeTime:
    """Return half of a long wake time, for a camera woken before it slept."""
    stated, wake = WakeTime.stated(camera.stated_wake_s), camera.wake
    if camera.sleep.early_s <= stated.early_s:
        return wake
    mean_s, sd_s = (wake.mean_s + stated.mean_s) / 2, (wake.sd_s + stated.sd_s) / 2
    return replace(wake, mean_s=mean_s, sd_s=sd_s)


# What follows from it.


def flooding(camera: CameraState, fps: float, now_ns: int) -> bool:
    """Return whether a camera floods: far more messages this second than needed."""
    return camera.messages > FLOOD_RATE * (fps + 10) and camera.second == now_ns // 10**9


def asleep_s(camera: CameraState, now_ns: int) -> float | None:
    """Return seconds until a camera is expected back; negative if it is late, None if awake.

    One that was told to sleep and still speaks is awake.
    """
    sleep, heard_ns, beat = camera.sleep, camera.heard_ns, camera.beat
    if not sleep.until:
        return None
    silent = heard_ns is None or now_ns - heard_ns > SILENT_S * 1e9 or not camera.present
    resting = beat is None or beat.mode in RESTING
    return (sleep.due_ns - now_ns) / 1e9 if silent or resting else None


def standing(
    camera: CameraState,
    joints: Sequence[str],
    image_size: tuple[int, int] | None,
    now_ns: int,
    known: Collection[tuple[str, ...]] | None = None,
) -> tuple[State, str]:
    """Return the state of a camera by its messages, and why it cannot be selected.

    Args:
        camera: what is known of it.
        joints: of the edge's skeleton, into which those of its detector are converted.
        image_size: of its calibration; None for any.
        now_ns: the time.
        known: joints of detectors that the edge's skeleton was chosen for; those of others must
            not be lost in the conversion. None for any.

    Returns:
        Its state, and for operators what is wrong; empty if it can be selected.
    """
    left_s, beat = asleep_s(camera, now_ns), camera.beat
    ended = beat is not None and (beat.ends or (beat.mode == "asleep" and not camera.present))
    if left_s is not None and not ended:  # one that was to stay connected may have lost its link
        if left_s > -SILENT_S:
            return State.ASLEEP, f"asleep for {max(left_s, 0.0):.0f} s"
        return State.LEFT, f"overslept by {-left_s:.0f} s"
    if camera.heard_ns is None:
        return State.LEFT, "never connected"
    if beat is not None and beat.ends:
        return State.LEFT, "stopped"
    if not camera.present:
        return State.LEFT, "not connected"
    if now_ns - camera.heard_ns > SILENT_S * 1e9:
        return State.LEFT, f"silent for {(now_ns - camera.heard_ns) / 1e9:.0f} s"
    why = _misfit(camera, joints, image_size, now_ns, known)
    return (State.BARRED if why else State.READY), why


def _misfit(
    camera: CameraState,
    joints: Sequence[str],
    image_size: tuple[int, int] | None,
    now_ns: int,
    known: Collection[tuple[str, ...]] | None,
) -> str:
    """Return why a camera that is connected cannot be selected; empty if it can."""
    hello, beat = camera.hello, camera.beat
    if sum(now_ns - at < RIVAL_S * 1e9 for at in camera.returns) >= RIVAL_RETURNS:
        speakers = " and ".join(map(str, sorted(camera.sessions[-2:])))
        return f"two programs run as {camera.camera_id} (sessions {speakers}): stop one of them"
    if now_ns < camera.quarantined_until_ns:
        return f"sends invalid messages ({camera.fault})"
    if hello is None:  # without a frame it does not know its size; the heartbeat may say why
        return (beat.problem if beat else "") or CONNECTING
    if hello.joints != tuple(joints):
        if not serves(hello.joints, joints):
            lacks = lacking(hello.joints, joints)
            missing = some([joint for joint in lacks if joint in BODY_JOINTS] or lacks)
            outputs, expects = _name(hello.joints), _name(joints)
            return f"detector outputs {outputs} without {missing}, the site expects {expects}"
        lost = "" if known is None or hello.joints in known else unused(hello.joints, joints)
        if lost:
            return f"{lost}, as the site expects {_name(joints)}: set skeleton in its file"
    if image_size is not None and tuple(hello.image_size) != tuple(image_size):
        width, height = hello.image_size
        return (
            f"image size {width} x {height}, but the calibration has "
            f"{image_size[0]} x {image_size[1]}"
        )
    if beat is None:
        return "connected, waiting for its first status"
    if beat.problem:
        return beat.problem
    if beat.battery_j is not None and beat.battery_j <= 0:
        return "battery empty" if beat.gauge else "battery empty (modelled)"
    if beat.clock_error_ns > CLOCK_ERROR_NS:
        return f"clock uncertain by {beat.clock_error_ns / 1e6:.0f} ms"
    frozen_s = max(FROZEN_S, FROZEN_FRAMES / hello.fps)
    return "no new frames" if now_ns - camera.frame_ns > frozen_s * 1e9 else ""


def _name(joints: Sequence[str]) -> str:
    skeleton = skeleton_of_joints(tuple(joints))
    return skeleton.name if skeleton.name in SHIPPED else plural(len(joints), "joint")


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """The cameras' part in one slot, as the edge saw it; arrays are `(num_cameras,)`.

    Attributes:
        states: the `State` of each before the slot was computed.
        ordered: whether each was selected, with an order in time.
        ages_s: from the middle of the slot until the view of each came; NaN where none was in time.
        views: that came of each so far, in time or late.
        late: that came too late of each so far.
        views_late: whether a view of each came too late since the slot before.
        orders_late: whether late orders excuse each for bringing no view.
        online: whether each can be reached.
        arrived: whether the view of each came in time; like `online` not made by `changed`.
    """

    states: Integers
    ordered: Flags
    ages_s: Floats
    views: Integers
    late: Integers
    views_late: Flags
    orders_late: Flags
    online: Flags = field(init=False)
    arrived: Flags = field(init=False)

    def __post_init__(self) -> None:
        online = self.states >= int(ON_TRIAL)  # comparing with a member takes four times as long
        object.__setattr__(self, "online", online)
        object.__setattr__(self, "arrived", np.isfinite(self.ages_s))

    @property
    def expected(self) -> Flags:
        """Cameras that can be reached, or sleep by order."""
        return np.asarray(self.online | (self.states == int(ASLEEP)))

    @property
    def reached(self) -> Flags:
        """Cameras that can be reached, or were wrongly presumed offline."""
        return np.asarray(self.online | self.arrived)

    @property
    def usable(self) -> Flags:
        """Cameras that count for the loop, which leaves out suspected ones by itself."""
        return np.asarray((self.states >= int(SUSPECTED)) | self.arrived)


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """The answers of cameras to their orders; a value. Arrays are `(num_cameras,)`.

    Attributes:
        share: of the newest orders that were answered in time.
        unanswered_s: of orders in a row without a view in time.
        silent: orders in a row without any view.
        seldom_s: for how long too few orders have been answered, while it could be reached.
        ages_s: `(num_cameras, NEWEST_AGES)` ages of the newest views when they came, at the place
            of their number; inf of a late one, -inf before there were so many.
        views: that came so far.
        late: of these, that came too late.
        orders: counted for the delivery, at most `DELIVERY_ORDERS`.
        delivered: share of these whose view came in time.
        delivered_late: share of these after which a view came too late.
        short: whether it brings too few views.
        settled_s: since that changed.
        blind_slots: slots in a row without any view.
    """

    share: Floats
    unanswered_s: Floats
    silent: Integers
    seldom_s: Floats
    ages_s: Floats
    views: Integers
    late: Integers
    orders: Floats
    delivered: Floats
    delivered_late: Floats
    short: Flags
    settled_s: Floats
    blind_slots: int = BLIND_SLOTS  # before the first view

    @classmethod
    def none(cls, num_cameras: int) -> Answers:
        """Return the answers before the first order: all cameras are presumed to answer."""
        zeros, counts = np.zeros(num_cameras), np.zeros(num_cameras, dtype=np.int64)
        return cls(
            share=np.ones(num_cameras),
            unanswered_s=zeros,
            silent=counts,
            seldom_s=zeros,
            ages_s=np.full((num_cameras, NEWEST_AGES), -np.inf),
            views=counts,
            late=counts,
            orders=zeros,
            delivered=zeros,
            delivered_late=zeros,
            short=np.zeros(num_cameras, dtype=bool),
            settled_s=np.full(num_cameras, SETTLED_S),
        )

    @property
    def reliable(self) -> Flags:
        """Cameras that answer enough of their orders."""
        return np.asarray(self.share >= RELIABLE)

    def delivery(self, camera: int) -> float | None:
        """Return the share of ordered views that came in time; None for few orders."""
        return float(self.delivered[camera]) if self.orders[camera] >= MIN_ORDERS else None

    def forgiven(self) -> Answers:
        """Return the answers with all cameras presumed to answer, as the edge was to blame."""
        return replace(Answers.none(len(self.share)), views=self.views, late=self.late)


def states_of(standings: Integers, answers: Answers, answering: Flags) -> Integers:
    """Return `(num_cameras,)`: the `State` of each camera.

    Where too few answer enough of their orders, none is on trial: one camera sees no depth.

    Args:
        standings: `(num_cameras,)` their states by their messages.
        answers: how they answer their orders.
        answering: `(num_cameras,)` cameras that the failure detector has not given up.
    """
    ready, reliable = standings == int(READY), answers.reliable
    on_trial = ~reliable & ((reliable & ready).sum() >= LEAST_RELIABLE)
    found = np.where(answering, int(READY), int(SUSPECTED))
    return np.where(ready, np.where(on_trial, int(ON_TRIAL), found), standings)


def after_slot(
    before: Answers, turn: Turn, given_up: Flags, interval_s: float, fair: bool = True
) -> Answers:
    """Return how cameras answer after one more slot.

    Args:
        before: the answers before it.
        turn: the slot.
        given_up: `(num_cameras,)` cameras that the failure detector gave up.
        interval_s: seconds per slot.
        fair: whether the edge keeps up, so that cameras are to blame for what they do not deliver.
    """
    ordered, arrived = turn.ordered & turn.online, turn.arrived
    came, ages_s = turn.views > before.views, before.ages_s.copy()
    for camera in np.flatnonzero(came).tolist():
        newest_s = turn.ages_s[camera] if arrived[camera] else np.inf
        ages_s[camera, turn.views[camera] % NEWEST_AGES] = newest_s
    blind_slots = 0 if arrived.any() else before.blind_slots + 1
    share = before.share
    if blind_slots < BLIND_SLOTS:
        share = np.where(ordered, share + (arrived - share) / SHARE_ORDERS, share)
    unreliable = share < RELIABLE
    return changed(
        before,
        **_delivered(before, ordered & ~turn.orders_late & fair, turn, given_up, interval_s),
        share=share,
        unanswered_s=np.where(arrived, 0.0, before.unanswered_s + interval_s * ordered),
        silent=np.where(came, 0, before.silent + ordered),
        seldom_s=np.where(unreliable, before.seldom_s + interval_s * turn.online, 0.0),
        ages_s=ages_s,
        views=turn.views,
        late=turn.late,
        blind_slots=blind_slots,
    )


def _delivered(
    before: Answers, counted: Flags, turn: Turn, given_up: Flags, interval_s: float
) -> dict[str, Any]:
    """Return the new delivery of cameras, by field; a returned camera is counted anew."""
    orders = np.where(given_up, 0, np.minimum(before.orders + counted, DELIVERY_ORDERS))
    weight = np.where(counted, 1 / np.maximum(orders, 1), 0.0)
    share = before.delivered + weight * (turn.arrived - before.delivered)
    known, settled = orders >= MIN_ORDERS, before.settled_s >= SETTLED_S
    too_few, enough = known & (share < SHORT) & settled, known & (share >= ENOUGH)
    changed = np.where(before.short, enough, too_few)
    return {
        "orders": orders,
        "delivered": share,
        "delivered_late": before.delivered_late
        + weight * (turn.views_late - before.delivered_late),
        "short": before.short ^ changed,
        "settled_s": np.where(changed, 0.0, before.settled_s + interval_s),
    }


# What follows from the answers.


def excused(answers: Answers, orders_late: Flags) -> Flags:
    """Return `(num_cameras,)`: cameras whose late orders excuse missing views."""
    return np.asarray(orders_late & (answers.unanswered_s < EXCUSED_S))


def waits_s(answers: Answers, awaited: Flags, deadline_s: float) -> Floats:
    """Return `(num_cameras,)`: how long after its middle a slot waits for each view, seconds.

    It waits until the deadline for cameras that answer most orders, and as long as their views
    usually take for the others. 0 for those that are not awaited, and for those that have been
    silent for some orders, until a view comes.

    Args:
        answers: of the cameras.
        awaited: `(num_cameras,)` cameras with an order.
        deadline_s: after which no slot waits.
    """
    wait_s = np.where(awaited & (answers.silent < SILENT_ORDERS), deadline_s, 0.0)
    for camera in np.flatnonzero((answers.share < AWAITED) & (wait_s > 0)).tolist():
        longest_s = answers.ages_s[camera].max()
        if longest_s > -np.inf:
            wait_s[camera] = min(PATIENCE * longest_s, wait_s[camera])
    return wait_s


def tried(answers: Answers, states: Integers, slot: int, interval_s: float) -> Flags:
    """Return `(num_cameras,)`: the camera that is tried in a slot.

    A trial costs the others nothing: the camera is ordered beside the selected ones, not in place
    of one. One camera is tried at a time, for `TURN_S` every `EVERY_S`, and more and more rarely
    while it does not recover.

    Args:
        answers: of the cameras.
        states: `(num_cameras,)` their `State`.
        slot: for which the order is.
        interval_s: seconds per slot.
    """
    cameras = np.arange(len(states))
    since_s = slot * interval_s + TURN_S * cameras
    pause = 2 ** np.minimum(answers.seldom_s // EVERY_S, MOST_DOUBLED).astype(np.int64)
    turn = (since_s % EVERY_S < TURN_S) & ((since_s // EVERY_S).astype(np.int64) % pause == 0)
    trial = turn & (states == int(ON_TRIAL))
    return np.asarray(trial & (cameras == trial.argmax()))


def followed(answers: Answers, silence: Silence) -> Flags:
    """Return `(num_cameras,)`: cameras whose delays the lead may follow."""
    return np.asarray((silence.failures < ATTEMPTS) & answers.reliable)


def impairments(
    answers: Answers,
    silence: Silence,
    lead: Lead,
    late_by_s: Floats,
    newest_late: Flags,
    interval_s: float,
) -> list[str]:
    """Return why each connected camera is useless; empty if it is useful.

    Args:
        answers: of the cameras.
        silence: of the failure detector.
        lead: with the delays of orders.
        late_by_s: `(num_cameras,)` age of late views; NaN where none were late.
        newest_late: `(num_cameras,)` whether the newest view was too late.
        interval_s: seconds of the scene per slot.
    """
    slow = lagging(lead)
    alive = silence.missed < patience(silence.loss, interval_s)
    found: list[str] = []
    for camera, age_s in enumerate(late_by_s.tolist()):
        failures, why = int(silence.failures[camera]), slow.get(camera, "")
        late = f"views arrive too late, {age_s * 1e3:.0f} ms after capture"
        if not why and failures >= REPORTED_LATE_FAILURES and alive[camera] and age_s < NEAR_S:
            why = late
        if not why and failures >= REPORTED_FAILURES:
            why = "no views arrive in time"
        if not why and answers.seldom_s[camera] >= SELDOM_S:
            share = f"answers {answers.share[camera]:.0%} of its orders in time"
            why = late if newest_late[camera] and not math.isnan(age_s) else share
        found.append(why)
    return found


def shortages(
    answers: Answers, cameras: Sequence[CameraState], slots_hz: float, pace: float
) -> list[str]:
    """Return the problem and fix of each camera with too few views; else empty.

    Args:
        answers: of the cameras.
        cameras: their states.
        slots_hz: slots per second.
        pace: seconds of the scene per second.
    """
    return [
        _shortage(camera, answers.delivery(index), late, slots_hz, pace)
        if answers.short[index] and (camera.frames_hz is not None or camera.counted is None)
        else ""  # also until the rate of its frames is known
        for index, (camera, late) in enumerate(
            zip(cameras, answers.delivered_late.tolist(), strict=True)
        )
    ]


def _shortage(
    camera: CameraState, arrived: float | None, late: float, slots_hz: float, pace: float
) -> str:
    if arrived is None:
        return "too few views arrived before it was left out, its views are counted anew"
    frames_hz, share = camera.frames_hz, f"{arrived:.0%} of the views ordered of it arrive in time"
    if frames_hz is not None and frames_hz < SHORT * slots_hz:
        slower = f"fps = {frames_hz / pace:.3g}" if pace == 1 else "a lower pace"
        return (
            f"its source brings {frames_hz:.3g} frames per second, the site has {slots_hz:.3g} "
            f"slots: {share}; set {slower} in the site file, or raise the camera's frame rate"
        )
    if late > (1 - arrived) / 2:
        return f"{share}, the others too late: raise deadline_ms, or lower fps"
    if camera.dropped_hz is not None and camera.dropped_hz > (1 - arrived) * slots_hz / 4:
        return f"{share}, its detector is too slow: lower fps, or take a faster network"
    return f"{share}, the others get lost: check its network connection"


def sleeps_as_told(camera: CameraStatus) -> bool:
    """Return whether a camera of a status sleeps by order and is not late."""
    asleep = not camera.online and not camera.paused and camera.asleep_s is not None
    return asleep and (camera.asleep_s or 0.0) > -SILENT_S


def claimed_wakes_s(
    cameras: Sequence[CameraState], idle_modes: Sequence[CameraMode]
) -> list[float | None]:
    """Return for each camera the wake-up time that it reports; None for one that never sleeps."""
    return [
        camera.hello.wake_s
        if camera.hello is not None and mode == "aggressive-power-saving"
        else None
        for camera, mode in zip(cameras, idle_modes, strict=True)
    ]
