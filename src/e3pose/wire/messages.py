"""Messages between cameras and edge. Append fields only, with defaults: old programs skip them.

The meaning of every field stands in its docstring, once: the reference and all that is made of a
field take it from there, by `fields`.

Times are integer nanoseconds since 1970. A time called `_ns` is by the sender's clock, one called
`edge_ns` by the edge's clock. Messages to users and operators are in `site_messages`.
"""

from __future__ import annotations

import inspect
import re
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from e3pose.energy.modes import RESTING as RESTING
from e3pose.wire.bounds import Amount, Count, OffsetNs, Session, Slot, TemperatureC, TimeNs

VERSION = 2  # of the messages; a program refuses others, and names who must be updated

CameraMode = Literal["active", "power-saving", "aggressive-power-saving"]
Activity = Literal["active", "power-saving", "aggressive-power-saving", "asleep", "suspended"]


class Uses(NamedTuple):
    """The use of a message's field outside it, beside its JSON of the same name.

    Attributes:
        metric: its name for Prometheus, after `e3pose_camera_`; empty if it has none.
        per: the metric is the value divided by this.
        unknown: value of the metric where the field is None; None for no value.
        column: its heading on the screen, and how early it gives way in a narrow terminal (0:
            never); None if it has none.
        home: its sensor in Home Assistant: title before the camera's name, and keys of discovery.
    """

    metric: str = ""
    per: float = 1.0
    unknown: float | None = None
    column: tuple[str, int] | None = None
    home: tuple[str, dict[str, str]] | None = None


class Field(NamedTuple):
    """A field of a message: its name, its meaning in words, what else it is."""

    name: str
    meaning: str
    uses: Uses


def fields(kind: type[msgspec.Struct]) -> list[Field]:
    """Return the fields of a message in its order, each with the meaning in its docstring."""
    words = re.split(r"^    (\w+): ", inspect.getdoc(kind) or "", flags=re.M)[1:]
    texts = (" ".join(text.split()).removesuffix(".") for text in words[1::2])
    meanings = dict(zip(words[::2], texts, strict=True))
    found = []
    for field in msgspec.structs.fields(kind):
        said = getattr(field.type, "__metadata__", ())
        uses = next((each for each in said if isinstance(each, Uses)), Uses())
        found.append(Field(field.name, meanings.get(field.name, field.name), uses))
    return found


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
        camera_id: sender.
        session: random number of this program start; a different one means a restart.
        joints: names of the detector's keypoints, in order.
        image_size: `(width, height)` of its images in pixels.
        fps: frame rate of its source.
        wake_s: seconds from aggressive power-saving to the first frame.
        detector: name of the network.
        software: version of the program.
        battery_wh: battery capacity; None on mains.
        rests: `"asleep"`, `"suspended"`: how an order may put it to sleep; empty: never.
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
        camera_id: sender.
        session: of the camera.
        slot: slot of the frame, by the camera's estimate of the edge's clock.
        captured_edge_ns: capture time, in that estimate.
        keypoints_px: `(num_persons, num_joints, 2)` f4 pixels of the real image; NaN where missing.
        scores: `(num_persons, num_joints)` f4 in [0, 1]; 0 where missing.
        clock_error_ns: uncertainty of that estimate.
        detect_ns: detection time.
        sent_edge_ns: send time.
        unchanged_ns: for how long the image is the same as in the look that found these people, so
            that the detector did not run; 0 if it did. Their errors are those of that look: the
            edge takes them as proof that people stand still, not as a second measurement. An edge
            of an older version takes them for a look.
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
        camera_id: sender.
        session: of the camera.
        sent_edge_ns: send time, by the camera's estimate of the edge's clock.
        mode: current mode.
        captured: frames captured since it started.
        detected: frames processed.
        sent: views sent.
        dropped: frames and views replaced by newer ones before they were processed.
        late_orders: orders that arrived after their slot began.
        orders: orders received.
        order_margin_ns: smallest time from an order's arrival to its slot since the last heartbeat;
            negative if late.
        clock_offset_ns: edge time minus camera time.
        clock_drift_ppm: drift of its clock against the edge's, parts per million.
        clock_error_ns: uncertainty of that offset.
        power_w: current power, as a mean since the heartbeat before where a model says it of a
            camera awake; None if unknown.
        energy_j: energy since it started, at the moment of `active_s` and `idle_s`; None if
            unknown.
        measured: whether power and energy are measured, not modelled.
        active_s: active seconds since it started: looks of the detector times the length of a slot.
        idle_s: other seconds awake since it started.
        battery_j: remaining charge; None on mains or if unknown.
        charging_w: charging power.
        problem: what prevents it from working; empty if nothing.
        order_delay_ns: longest time, since the last heartbeat, from the middle of the slot an order
            was made from to its arrival; 0 without orders.
        gauge: whether `battery_j` comes from a gauge, not a model.
        ends: whether this is its last heartbeat because the program stops.
        temperature_c: hottest sensor of the device, degrees Celsius; None without one.
        recording_j: part of `energy_j` that recording video has used, by a model.
        focused: processed frames for which the order said where people are expected.
        asleep_until: slot from which it is to be awake, in the modes `asleep` and `suspended`; else
            0.
        asleep_s: seconds asleep or suspended since it started, not part of `idle_s`.
        cpu_s: processor time of its program since it started to capture; None if unknown.
        look_cpu_s: part of `cpu_s` that looking took.
        unchanged: frames in which nothing changed since its last look, so that the detector did not
            run; not in `detected`.
    """

    camera_id: str
    session: Session
    sent_edge_ns: TimeNs
    mode: Activity
    captured: Count = 0
    detected: Count = 0
    sent: Count = 0
    dropped: Annotated[Count, Uses(metric="dropped")] = 0
    late_orders: Annotated[Count, Uses(metric="late_orders")] = 0
    orders: Annotated[Count, Uses(metric="orders")] = 0
    order_margin_ns: Annotated[OffsetNs, Uses(metric="order_margin_seconds", per=1e9)] = 0
    clock_offset_ns: OffsetNs = 0
    clock_drift_ppm: Annotated[float, Meta(ge=-1e6, le=1e6), Uses(metric="clock_drift_ppm")] = 0.0
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
        camera_id: receiver.
        slot: slot of the order.
        active: whether to detect and send.
        idle_mode: mode in slots without an active order.
        origin_edge_ns: middle of slot 0.
        interval_ns: length of a slot.
        sent_edge_ns: send time.
        session: of the edge; orders of an older session are void.
        lead: slots from the one that the order was made from to its own.
        expected_px: `(num_persons, num_joints, 2)` f4 pixels of the real image where people are
            expected, also beyond its border; NaN where unknown; at most 32 people. None: process
            the whole image.
        reach_px: `(num_persons,)` f4: 90 % of those keypoints are at most so many pixels off.
        asleep_until: sleep from this order's slot on, and be heard in time for the order of this
            slot; 0: stay awake.
        wake_s: seconds from alarm to being heard, as the edge learned them for this camera: mean
            and two standard deviations; 0: the camera's own.
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
        camera_id: sender.
        sent_ns: send time, by its own clock.
    """

    camera_id: str
    sent_ns: TimeNs


class ClockAnswer(msgspec.Struct, array_like=True, frozen=True, tag="clock"):
    """The edge's answer; with its arrival time it makes four time stamps.

    Attributes:
        asked_ns: `sent_ns` of the question.
        received_edge_ns: arrival time of the question.
        sent_edge_ns: send time of the answer.
    """

    asked_ns: TimeNs
    received_edge_ns: TimeNs
    sent_edge_ns: TimeNs
