"""Messages between cameras and edge. Append fields only, with defaults: old programs skip them.

Times are integer nanoseconds since 1970. A time called `_ns` is by the sender's clock, one called
`edge_ns` by the edge's clock. Messages to users and operators are in `site_messages`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from e3pose.energy.modes import RESTING as RESTING
from e3pose.wire.bounds import Amount, Count, OffsetNs, Session, Slot, TemperatureC, TimeNs

VERSION = 1  # of the messages; a program refuses others, and names who must be updated

CameraMode = Literal["active", "power-saving", "aggressive-power-saving"]
Activity = Literal["active", "power-saving", "aggressive-power-saving", "asleep", "suspended"]


class Array(msgspec.Struct, array_like=True, frozen=True):
    """An array: its bytes are little-endian, in C order.

    Attributes:
        dtype: `f4`, `f8`, `i8` or `b1`, after numpy.
        shape: lengths of the axes.
        data: as many bytes as that takes.
    """

    dtype: Literal["f4", "f8", "i8", "b1"]
    shape: tuple[int, ...]
    data: bytes


class Hello(msgspec.Struct, array_like=True, frozen=True, tag="hello"):
    """Description of a camera, sent when it connects and every few seconds.

    Replaced by a newer one of the same camera.

    Attributes:
        camera_id: of the camera.
        session: a number drawn when the program started; another one means that it was restarted.
        joints: names of the keypoints that its detector finds, in order.
        image_size: `(width, height)` in pixels of the images it looks at.
        fps: frames per second of its source.
        wake_s: time from aggressive power-saving to its first frame.
        detector: name of the network.
        software: version of the program.
        battery_wh: capacity of the battery; None on mains.
        rests: of `RESTING`, those that an order may put it into; a camera of an older program has
            none, and is never told to sleep.
    """

    camera_id: str
    session: Session
    joints: tuple[str, ...]
    image_size: tuple[int, int]
    fps: Annotated[float, Meta(ge=0.01, le=1000)]
    wake_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    detector: str = ""
    software: str = ""
    battery_wh: Annotated[float, Meta(ge=1e-6, le=1e6)] | None = None
    rests: tuple[str, ...] = ()


class View(msgspec.Struct, array_like=True, frozen=True, tag="view"):
    """The detections of a camera in one slot.

    Replaced by a newer one of the same camera and slot.

    Attributes:
        camera_id: of the camera.
        session: of the camera.
        slot: which slot the frame belongs to, by the camera's estimate of the edge's clock.
        captured_edge_ns: when the frame was taken, in that estimate.
        keypoints_px: `(num_persons, num_joints, 2)` f4 pixels of the real image; NaN where missing.
        scores: `(num_persons, num_joints)` f4 in [0, 1]; 0 where missing.
        clock_error_ns: how far that estimate may be off.
        detect_ns: how long detection took.
        sent_edge_ns: when the message left.
        unchanged_ns: for how long the image is the same as in the look that found these people;
            0 in that look itself. The network did not run then, and errors are the same.
    """

    camera_id: str
    session: Session
    slot: Slot
    captured_edge_ns: TimeNs
    keypoints_px: Array
    scores: Array
    clock_error_ns: TimeNs = 0
    detect_ns: TimeNs = 0
    sent_edge_ns: TimeNs = 0
    unchanged_ns: TimeNs = 0


class Heartbeat(msgspec.Struct, array_like=True, frozen=True, tag="heartbeat"):
    """Status of a camera; about twice a second, between two slots, and when it falls asleep.

    Replaced by a newer one of the same camera.

    Attributes:
        camera_id: of the camera.
        session: of the camera.
        sent_edge_ns: when, by the camera's estimate of the edge's clock.
        mode: current mode.
        captured: frames taken since it started.
        detected: frames on which the detector ran.
        sent: views sent.
        dropped: frames and views that a newer one replaced before they were dealt with.
        late_orders: orders that arrived after their slot.
        orders: orders that arrived.
        order_margin_ns: the least time, since the heartbeat before, from an order to its slot.
        clock_offset_ns: edge time minus camera time.
        clock_drift_ppm: its drift, millionths.
        clock_error_ns: bound of its error.
        power_w: of the device now; None where unknown.
        energy_j: since it started, at the moment of `active_s` and `idle_s`; None where unknown.
        measured: whether power and energy were measured; otherwise a model estimates them.
        active_s: looks of the detector since it started times the length of a slot, seconds.
        idle_s: other seconds awake.
        battery_j: remaining charge; None on mains or where unknown.
        charging_w: charging power of the battery.
        problem: why it does not work, for operators; empty if it does.
        order_delay_ns: the longest, since then, from the slot of an order's making to its arrival.
        gauge: whether a gauge measures `battery_j`; otherwise a model estimates it.
        ends: whether this is its last heartbeat, as its program was stopped.
        temperature_c: of the device; None without a sensor.
        recording_j: part of `energy_j` that recording video has taken, by a model.
        focused: of the detected frames, those with an expected view.
        asleep_until: slot from which it is to be awake, in the modes of `RESTING`; 0 in others.
        asleep_s: seconds that it was asleep or suspended since it started, not in `idle_s`.
        cpu_s: processor time that its program took since it started to capture; None where unknown.
        look_cpu_s: part of `cpu_s` that looking took.
        unchanged: frames in which nothing changed since its last look: the detector did not run.
    """

    camera_id: str
    session: Session
    sent_edge_ns: TimeNs
    mode: Activity
    captured: Count = 0
    detected: Count = 0
    sent: Count = 0
    dropped: Count = 0
    late_orders: Count = 0
    orders: Count = 0
    order_margin_ns: OffsetNs = 0
    clock_offset_ns: OffsetNs = 0
    clock_drift_ppm: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    clock_error_ns: TimeNs = 0
    power_w: Amount | None = None
    energy_j: Amount | None = None
    measured: bool = False
    active_s: Amount = 0.0
    idle_s: Amount = 0.0
    battery_j: Amount | None = None
    charging_w: Amount = 0.0
    problem: str = ""
    order_delay_ns: TimeNs = 0
    gauge: bool = False
    ends: bool = False
    temperature_c: TemperatureC | None = None
    recording_j: Amount = 0.0
    focused: Count = 0
    asleep_until: Slot = 0
    asleep_s: Amount = 0.0
    cpu_s: Amount | None = None
    look_cpu_s: Amount = 0.0
    unchanged: Count = 0


class Order(msgspec.Struct, array_like=True, frozen=True, tag="order"):
    """Order of the edge to a camera: its mode in a slot, and the slot times.

    Replaced by a newer one for the same camera and slot; a camera just started needs no other.

    Attributes:
        camera_id: the recipient.
        slot: the slot of the order.
        active: whether to detect and send in it.
        idle_mode: what to do in slots without an active order.
        origin_edge_ns: when the middle of slot 0 is.
        interval_ns: length of a slot.
        sent_edge_ns: when the order left.
        session: of the edge; orders of an older session count no more.
        lead: slots from the one that the order was made from to its own.
        expected_px: `(num_persons, num_joints, 2)` f4 pixels where people will be; None: anywhere.
        reach_px: `(num_persons,)` f4 how far off nine of ten of those are at most.
        asleep_until: the camera sleeps from this order's slot on and is awake, and heard, in time
            for its order for this slot; 0 to stay awake.
        wake_s: how long before that it sets its alarm: what it takes to wake, as the edge learned;
            0 where the camera is to know.
    """

    camera_id: str
    slot: Slot
    active: bool
    idle_mode: CameraMode
    origin_edge_ns: OffsetNs  # negative where a machine began at 1970 and goes on with old slots
    interval_ns: Annotated[int, Meta(ge=1_000_000, le=3_600_000_000_000)]
    sent_edge_ns: TimeNs
    session: Session
    lead: Annotated[int, Meta(ge=1, le=1000)] = 1
    expected_px: Array | None = None
    reach_px: Array | None = None
    asleep_until: Slot = 0
    wake_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0


class ClockQuestion(msgspec.Struct, array_like=True, frozen=True, tag="clock?"):
    """A camera asks the edge for the time.

    Attributes:
        camera_id: the sender.
        sent_ns: when, by its own clock.
    """

    camera_id: str
    sent_ns: TimeNs


class ClockAnswer(msgspec.Struct, array_like=True, frozen=True, tag="clock"):
    """The edge's answer; with its arrival time it makes four time stamps.

    Attributes:
        asked_ns: `sent_ns` of the question.
        received_edge_ns: when the question came.
        sent_edge_ns: when the answer left.
    """

    asked_ns: TimeNs
    received_edge_ns: TimeNs
    sent_edge_ns: TimeNs
