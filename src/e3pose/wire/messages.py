"""Every message as a small record. Append fields only, with defaults: old programs skip them.

Times are integer nanoseconds since 1970. Camera clocks are not the edge's: a time called `_ns` is
of whoever sends the message, one called `edge_ns` is of the edge.
"""

from __future__ import annotations

from typing import Literal

import msgspec

VERSION = 1  # of the messages; a program refuses others, and names who must be updated

CameraMode = Literal["active", "power-saving", "aggressive-power-saving"]


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
    """A camera says what it is, when it connects and every few seconds.

    Replaced by a newer one of the same camera.

    Attributes:
        camera_id: who.
        session: a number drawn when the program started; another one means that it was restarted.
        joints: names of the keypoints that its detector finds, in order.
        image_size: `(width, height)` in pixels of the images it looks at.
        fps: frames a second that its source delivers.
        wake_s: how long it takes from aggressive power-saving to its first frame.
        detector: name of the network.
        software: version of the program.
        battery_wh: capacity of the battery; None on mains.
    """

    camera_id: str
    session: int
    joints: tuple[str, ...]
    image_size: tuple[int, int]
    fps: float
    wake_s: float = 0.0
    detector: str = ""
    software: str = ""
    battery_wh: float | None = None


class View(msgspec.Struct, array_like=True, frozen=True, tag="view"):
    """What a camera saw in one slot.

    Replaced by a newer one of the same camera and slot.

    Attributes:
        camera_id: who saw it.
        session: of the camera.
        slot: which slot the frame belongs to, by the camera's estimate of the edge's clock.
        captured_edge_ns: when the frame was taken, in that estimate.
        keypoints_px: `(num_persons, num_joints, 2)` f4 pixels of the real image; NaN where missing.
        scores: `(num_persons, num_joints)` f4 in [0, 1]; 0 where missing.
        clock_error_ns: how far that estimate may be off.
        detect_ns: how long detection took.
        sent_edge_ns: when the message left.
    """

    camera_id: str
    session: int
    slot: int
    captured_edge_ns: int
    keypoints_px: Array
    scores: Array
    clock_error_ns: int = 0
    detect_ns: int = 0
    sent_edge_ns: int = 0


class Heartbeat(msgspec.Struct, array_like=True, frozen=True, tag="heartbeat"):
    """How a camera is; twice a second, and when its mode changes.

    Replaced by a newer one of the same camera.

    Attributes:
        camera_id: who.
        session: of the camera.
        sent_edge_ns: when, by the camera's estimate of the edge's clock.
        mode: what it does now.
        captured: frames taken since it started.
        detected: frames looked at.
        sent: views sent.
        dropped: frames and views that a newer one replaced before they were dealt with.
        late_orders: orders that came after the slot they were for.
        orders: orders that came.
        order_margin_ns: the least time, since the heartbeat before, from an order to its slot.
        clock_offset_ns: edge time minus camera time.
        clock_drift_ppm: how fast that grows, millionths.
        clock_error_ns: how far it may be off.
        power_w: what the device draws now; None where unknown.
        energy_j: what it has drawn since it started; None where unknown.
        measured: whether power and energy were measured; otherwise a model says them.
        active_s: seconds it was active since it started.
        idle_s: seconds it was not.
        battery_j: charge that is left; None on mains or where unknown.
        charging_w: power that the battery is given.
        problem: what keeps it from working, in words; empty if nothing.
        order_delay_ns: the longest, since then, from the slot of an order's making to its arrival.
        gauge: whether a gauge says `battery_j`; otherwise a model says it.
        ends: whether this is its last word, as its program was told to end.
        temperature_c: of the device; None without a sensor.
        recording_j: part of `energy_j` that recording video has taken, by a model.
        focused: of the detected frames, those in which it was told whom to expect where.
    """

    camera_id: str
    session: int
    sent_edge_ns: int
    mode: CameraMode
    captured: int = 0
    detected: int = 0
    sent: int = 0
    dropped: int = 0
    late_orders: int = 0
    orders: int = 0
    order_margin_ns: int = 0
    clock_offset_ns: int = 0
    clock_drift_ppm: float = 0.0
    clock_error_ns: int = 0
    power_w: float | None = None
    energy_j: float | None = None
    measured: bool = False
    active_s: float = 0.0
    idle_s: float = 0.0
    battery_j: float | None = None
    charging_w: float = 0.0
    problem: str = ""
    order_delay_ns: int = 0
    gauge: bool = False
    ends: bool = False
    temperature_c: float | None = None
    recording_j: float = 0.0
    focused: int = 0


class Order(msgspec.Struct, array_like=True, frozen=True, tag="order"):
    """The edge tells a camera what to do in a slot, and where slots lie in time.

    Replaced by a newer one for the same camera and slot; a camera just started needs no other.

    Attributes:
        camera_id: who is told.
        slot: for which slot.
        active: whether to detect and send in it.
        idle_mode: what to do in slots without an active order.
        origin_edge_ns: when the middle of slot 0 is.
        interval_ns: length of a slot.
        sent_edge_ns: when the order left.
        session: of the edge; orders of an older session count no more.
        lead: how many slots ahead orders are given at present.
        expected_px: `(num_persons, num_joints, 2)` f4 pixels where people will be; None: anywhere.
        reach_px: `(num_persons,)` f4 how far off nine of ten of those are at most.
    """

    camera_id: str
    slot: int
    active: bool
    idle_mode: CameraMode
    origin_edge_ns: int
    interval_ns: int
    sent_edge_ns: int
    session: int
    lead: int = 1
    expected_px: Array | None = None
    reach_px: Array | None = None


class ClockQuestion(msgspec.Struct, array_like=True, frozen=True, tag="clock?"):
    """A camera asks the edge for the time.

    Attributes:
        camera_id: who asks.
        sent_ns: when, by its own clock.
    """

    camera_id: str
    sent_ns: int


class ClockAnswer(msgspec.Struct, array_like=True, frozen=True, tag="clock"):
    """The edge's answer; with the time of its arrival it makes four time stamps.

    Attributes:
        asked_ns: `sent_ns` of the question.
        received_edge_ns: when the question came.
        sent_edge_ns: when the answer left.
    """

    asked_ns: int
    received_edge_ns: int
    sent_edge_ns: int


class Poses(msgspec.Struct, array_like=True, frozen=True, tag="poses"):
    """The people of one slot, for whoever subscribes.

    Replaced by a newer one.

    Attributes:
        slot: which.
        time_edge_ns: when the slot was.
        joints: names of the joints, in order.
        track_ids: `(num_persons,)` i8.
        joints_m: `(num_persons, num_joints, 3)` f4 world metres; NaN where unknown.
        sigma_m: `(num_persons, num_joints)` f4 standard deviation along an axis; NaN where unknown.
        measured: `(num_persons, num_joints)` b1; the others are carried on from earlier slots.
        published_edge_ns: when the message left.
        selected: cameras that were to look in the slot; empty of people who are told again.
        arrived: those of them whose views are in the poses.
    """

    slot: int
    time_edge_ns: int
    joints: tuple[str, ...]
    track_ids: Array
    joints_m: Array
    sigma_m: Array
    measured: Array
    published_edge_ns: int = 0
    selected: tuple[str, ...] = ()
    arrived: tuple[str, ...] = ()


class CameraStatus(msgspec.Struct, array_like=True, frozen=True):
    """What the edge knows of a camera.

    Attributes:
        camera_id: who.
        online: whether it can be selected.
        why: if not, why; else what is odd about it.
        mode: what it said last.
        last_seen_s: seconds since its last message; None if never.
        duty: share of the last minute's slots in which it was selected.
        power_w: what it says it draws.
        measured: whether that was measured.
        battery: share of the battery that is left; None on mains or where unknown.
        deficit: its energy deficit queue.
        late: views that came after their slot was closed, since the start.
        lost: views that were ordered and never came.
        clock_offset_ms: edge time minus camera time.
        gauge: whether the battery's gauge says what is left; otherwise a model does.
        noise_factor: sigma of its keypoints over the noise file's, as learned; None if unknown.
        shift_px: how far all of its keypoints are off, as learned and taken off; None if unknown.
        occlusion: of the people in its view, predicted for the slot decided last, [0, 1].
        gain_nats: information a joint that it adds to the others; None if not worked out.
        price: what its energy queue asks for it, on the same scale.
        temperature_c: of the device, by its own sensor; None where there is none.
        paused: whether an operator had it left out.
        budget: share of the slots in which it may be active, as a mean.
        turned_deg: by how much, at least, it was turned since it was calibrated; None if it
            stands as calibrated as far as can be seen.
        focused: frames in which it was told whom to expect where, since it started.
    """

    camera_id: str
    online: bool
    why: str = ""
    mode: CameraMode | None = None
    last_seen_s: float | None = None
    duty: float = 0.0
    power_w: float | None = None
    measured: bool = False
    battery: float | None = None
    deficit: float = 0.0
    late: int = 0
    lost: int = 0
    clock_offset_ms: float = 0.0
    gauge: bool = False
    noise_factor: float | None = None
    shift_px: float | None = None
    occlusion: float | None = None
    gain_nats: float | None = None
    price: float | None = None
    temperature_c: float | None = None
    paused: bool = False
    budget: float | None = None
    turned_deg: float | None = None
    focused: int = 0


class Control(msgspec.Struct, array_like=True, frozen=True, tag="control"):
    """An operator asks the edge to run otherwise from the next slot on; until it is restarted.

    What is None or empty stays as it is.

    Attributes:
        cameras: cameras a slot, as a mean; ends aiming at an error.
        target_error_mm: wake as few as keep the expected error below this; in place of `cameras`.
        quality_weight: the paper's V.
        camera_id: of the camera that the rest is about.
        paused: whether that camera is left out.
        budget: what it may spend, as people write it: `60%`, `4W`, `until 18:00`.
    """

    cameras: float | None = None
    target_error_mm: float | None = None
    quality_weight: float | None = None
    camera_id: str = ""
    paused: bool | None = None
    budget: str = ""


class Controlled(msgspec.Struct, array_like=True, frozen=True, tag="controlled"):
    """The edge's answer to a `Control`.

    Attributes:
        said: what it does, in words; empty where it refuses.
        problem: why it refuses; empty where it does not.
    """

    said: str = ""
    problem: str = ""


class Picture(msgspec.Struct, array_like=True, frozen=True, tag="picture"):
    """A camera's answer to an operator who asks for what it looks at.

    Attributes:
        camera_id: who.
        slot: in which it detected in that image.
        image_size: `(width, height)` in pixels of the image it looked at.
        jpeg: of the image, made small.
        count: pictures made since its program started.
        energy_j: modelled energy of making them, all of them together.
    """

    camera_id: str
    slot: int
    image_size: tuple[int, int]
    jpeg: bytes
    count: int = 0
    energy_j: float = 0.0


class Status(msgspec.Struct, array_like=True, frozen=True, tag="status"):
    """How the site is; once a second. Replaced by a newer one.

    Attributes:
        site: its name.
        slot: the newest slot that was closed.
        fps: slots a second, measured.
        lead: slots between an order and the slot it is for.
        people: how many were there in that slot.
        cameras: of the whole rig, in its order.
        step_ms: median and 99th percentile of a slot's computing.
        latency_ms: median and 99th percentile from the last view's arrival to the poses.
        uptime_s: since the edge was started.
        events: the newest things worth telling, newest last.
        expected_error_mm: what the estimator expects of itself; None where unknown.
        slots_lost: slots that were never computed.
        num_selected: cameras a slot that the policy is to wake; None where it has no number.
        target_error_mm: the expected error that it aims at instead; None where it does not.
        quality_weight: its V; None where it has none.
    """

    site: str
    slot: int
    fps: float
    lead: int
    people: int
    cameras: tuple[CameraStatus, ...]
    step_ms: tuple[float, float] = (0.0, 0.0)
    latency_ms: tuple[float, float] = (0.0, 0.0)
    uptime_s: float = 0.0
    events: tuple[str, ...] = ()
    expected_error_mm: float | None = None
    slots_lost: int = 0
    num_selected: float | None = None
    target_error_mm: float | None = None
    quality_weight: float | None = None


Message = (
    Hello
    | View
    | Heartbeat
    | Order
    | ClockQuestion
    | ClockAnswer
    | Poses
    | Control
    | Controlled
    | Picture
    | Status
)
