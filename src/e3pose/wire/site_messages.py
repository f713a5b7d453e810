"""Messages of a site to its users and operators: poses, status, control, pictures.

Append fields only, with defaults, as in `messages`; `CameraStatus` goes by names.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from e3pose.wire.bounds import (
    Count,
    Figure,
    Share,
    SignedFigure,
    Slot,
    TemperatureC,
    TimeNs,
)
from e3pose.wire.messages import Activity, Array, Uses


class Poses(msgspec.Struct, array_like=True, frozen=True, tag="poses"):
    """The people of one slot, for subscribers.

    Replaced by a newer one.

    Attributes:
        slot: number of the slot.
        time_edge_ns: middle of the slot.
        joints: names of the joints, in order.
        track_ids: `(num_persons,)` i8.
        joints_m: `(num_persons, num_joints, 3)` f4 world metres; NaN where unknown.
        sigma_m: `(num_persons, num_joints)` f4 standard deviation along an axis; NaN where unknown.
        measured: `(num_persons, num_joints)` b1; false: predicted from earlier slots.
        published_edge_ns: send time.
        selected: cameras ordered to detect in the slot.
        arrived: those whose views the poses are made from.
        blind: why the slot is blind; empty if it is not.
        stored_from: oldest slot of this edge program that its store holds or is to hold; -1 where
            nothing is stored yet.
        stored_to: the store holds every slot that this program published from `stored_from` to this
            one; none while it is smaller.
        store_shed: records that the store gave up since the edge started, each reported by an event
            `store-shed` or `store-refused`.
        delay_ms: of delayed poses: how much later they are published, smoothed with the slots in
            between; 0 of those at once.
    """

    slot: Slot
    time_edge_ns: TimeNs
    joints: tuple[str, ...]
    track_ids: Array
    joints_m: Array
    sigma_m: Array
    measured: Array
    published_edge_ns: int = 0
    selected: tuple[str, ...] = ()
    arrived: tuple[str, ...] = ()
    blind: str = ""
    stored_from: int = -1
    stored_to: int = -1
    store_shed: int = 0
    delay_ms: float = 0.0


class CameraStatus(msgspec.Struct, frozen=True):
    """The status of a camera, by the names of its fields.

    A name keeps its meaning for good; a new one has a default, and stands where it reads best.

    Attributes:
        camera_id: the camera.
        online: whether it can be selected.
        why: reason if it cannot be selected; otherwise a warning.
        mode: last reported mode; None before the first.
        title: what people call it; by default its id.
        duty: share of the last minute's slots in which it was selected, blind slots left out.
        power_w: reported power; None if unknown.
        measured: whether the power is measured; otherwise a model estimates it.
        cpu_s: processor time of its program since it started to capture; None if unknown.
        cpu_saved: processor time saved, as a share of that of activity in every slot; None
            while too little is known.
        battery: remaining charge, 0 to 1; None on mains or if unknown.
        gauge: whether the charge comes from a gauge, not a model.
        deficit: energy-deficit queue: what it spent beyond its budget so far, in slots.
        last_seen_s: seconds since its last message; None if never.
        late: views that arrived after their slot was closed.
        lost: ordered views that never arrived.
        ordered: views ordered in time since the edge started.
        delivered: share of the newest ordered views that arrived in time; None while they are
            too few.
        clock_offset_ms: edge time minus camera time.
        noise_factor: learned sigma of its keypoints over that of the noise model; None if unknown.
        occlusion: predicted overlap of the people in its view in the slot decided last, eq. (4);
            None if unknown.
        gain_nats: expected information per joint that its view adds to the other cameras; None if
            the policy does not use it.
        price: what selecting it costs, on the scale of the information: grows with its deficit;
            None if the policy does not use it.
        temperature_c: hottest sensor of the device, degrees Celsius; None without one.
        paused: whether an operator paused it.
        budget: share of slots in which it may be active, as a mean.
        turned_deg: by how much, at least, it was turned since it was calibrated; None if it stands
            as calibrated, as far as can be seen.
        focused: frames it processed with feedback since it started.
        source_fps: frames per second that its source brings, measured; None if unknown.
        asleep_s: seconds until it is expected back from an ordered sleep; negative while it
            oversleeps, None while it is awake.
        wake_s: seconds it takes to wake, mean as learned; None before its first wake.
        unchanged: share of its looks in which its image was unchanged, so that the network did not
            run; None without any.
    """

    camera_id: str
    online: Annotated[bool, Uses(metric="online")]
    why: str = ""
    mode: Activity | None = None
    title: str = ""
    duty: Annotated[Share, Uses(metric="duty", column=("duty", 0))] = 0.0
    power_w: Annotated[Figure | None, Uses(metric="watts", column=("W", 0))] = None
    measured: bool = False
    cpu_s: Annotated[Figure | None, Uses(metric="cpu_seconds", column=("CPU s", 2))] = None
    cpu_saved: Annotated[Share | None, Uses(metric="cpu_saved", column=("CPU saved", 1))] = None
    battery: Annotated[
        Share | None,
        Uses(
            metric="battery",
            column=("battery", 0),
            home=("Battery of", {"device_class": "battery", "unit_of_measurement": "%"}),
        ),
    ] = None
    gauge: bool = False
    deficit: Annotated[SignedFigure, Uses(metric="deficit", column=("deficit", 5))] = 0.0
    last_seen_s: Annotated[SignedFigure | None, Uses(column=("age", 6))] = None
    late: Annotated[Count, Uses(metric="late_views", column=("late", 0))] = 0
    lost: Annotated[Count, Uses(metric="lost_views", column=("lost", 0))] = 0
    ordered: Annotated[Count, Uses(metric="ordered_views")] = 0
    delivered: Annotated[Share | None, Uses(metric="delivered", column=("got", 7))] = None
    clock_offset_ms: Annotated[SignedFigure, Uses(column=("clock ms", 4))] = 0.0
    noise_factor: Annotated[float | None, Uses(metric="noise_factor", column=("noise", 3))] = None
    occlusion: Share | None = None
    gain_nats: SignedFigure | None = None
    price: SignedFigure | None = None
    temperature_c: TemperatureC | None = None
    paused: bool = False
    budget: Share | None = None
    turned_deg: Annotated[float | None, Uses(metric="turned_degrees", unknown=0.0)] = None
    focused: Count = 0
    source_fps: Annotated[Figure | None, Uses(metric="source_fps")] = None
    asleep_s: Annotated[SignedFigure | None, Uses(metric="asleep_seconds")] = None
    wake_s: Annotated[Figure | None, Uses(metric="wake_seconds")] = None
    unchanged: Annotated[Share | None, Uses(metric="unchanged")] = None

    def __post_init__(self) -> None:
        if not self.title:
            msgspec.structs.force_setattr(self, "title", self.camera_id)


class Control(msgspec.Struct, array_like=True, frozen=True, tag="control"):
    """Request of an operator to change settings of the running edge, until it restarts.

    What is None or empty stays as it is.

    Attributes:
        cameras: cameras per slot; replaces a target error.
        target_error_mm: target for the expected error; replaces `cameras`.
        quality_weight: quality weight V.
        camera_id: camera of the following fields.
        paused: whether to exclude it.
        budget: its energy budget, such as `60%` or `4W`.
        reread: take zones, the usual budget, `keep` and `max_size` from the site file as it is now;
            default false.
    """

    cameras: Figure | None = None
    target_error_mm: Figure | None = None
    quality_weight: Figure | None = None
    camera_id: str = ""
    paused: bool | None = None
    budget: str = ""
    reread: bool = False


class Controlled(msgspec.Struct, array_like=True, frozen=True, tag="controlled"):
    """The edge's answer to a `Control`.

    Attributes:
        said: what changed; empty if refused.
        problem: why it is refused; empty if it is not.
    """

    said: str = ""
    problem: str = ""


class PictureQuestion(msgspec.Struct, array_like=True, frozen=True, tag="picture-question"):
    """Request of an operator to see the newest image in which a camera detected.

    Attributes:
        have_ns: `captured_edge_ns` of the picture that the operator has; it is not sent again.
        large: 960 pixels wide instead of 320.
    """

    have_ns: TimeNs = 0
    large: bool = False


class Picture(msgspec.Struct, array_like=True, frozen=True, tag="picture"):
    """The newest image in which a camera detected, for an operator.

    Attributes:
        camera_id: sender.
        slot: slot in which it detected in the image.
        image_size: `(width, height)` of that image in pixels.
        jpeg: the image, at most 320 pixels wide, or 960 if asked; empty if there is none, or the
            operator has it.
        count: pictures made since the program started.
        energy_j: modelled energy of making them.
        captured_edge_ns: time of capture by the edge's clock, nanoseconds since 1970.
        drawn: whether it is drawn from keypoints, as the source plays keypoints without images.
        why: why there is no picture; empty otherwise.
    """

    camera_id: str
    slot: Slot
    image_size: tuple[int, int]
    jpeg: bytes
    count: Count = 0
    energy_j: Figure = 0.0
    captured_edge_ns: TimeNs = 0
    drawn: bool = False
    why: str = ""


Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
Digests = Annotated[tuple[Digest, ...], msgspec.Meta(max_length=500)]


class OutboxQuestion(msgspec.Struct, array_like=True, frozen=True, tag="outbox-question"):
    """Request of a hub for summaries of the site.

    Attributes:
        after: number up to which it has them.
        readers: SHA-256 of the tokens, hexadecimal, by which its users may see the site's page now.
        writers: likewise of those who may also control the site.
    """

    after: Count = 0
    readers: Digests = ()
    writers: Digests = ()


class Tombstone(msgspec.Struct, array_like=True, frozen=True):
    """That a day or a person was deleted at a site.

    Attributes:
        number: in the order of the outbox.
        start_ns: from when on; of a person that of the run.
        end_ns: until when, not included.
        run_started_ns: of a person: which run, by its start; None for everything in that time.
        track_id: the person.
    """

    number: Count
    start_ns: TimeNs
    end_ns: TimeNs
    run_started_ns: TimeNs | None = None
    track_id: Count | None = None


class OutboxPart(msgspec.Struct, array_like=True, frozen=True, tag="outbox-part"):
    """The edge's answer to an `OutboxQuestion`.

    Attributes:
        begun_ns: when the outbox was begun; another value is another outbox.
        newest: number given last.
        shed: summaries up to this number had to make room.
        rows: JSON list of summaries after that number, oldest first, at most 100.
        problem: why there are none; empty where there is no problem.
        forgotten: what was deleted after that number: `[number, start_ns, end_ns, run_started_ns,
            track_id]`, the last two null for a day.
    """

    begun_ns: TimeNs = 0
    newest: Count = 0
    shed: Count = 0
    rows: bytes = b"[]"
    problem: str = ""
    forgotten: tuple[Tombstone, ...] = ()


class Status(msgspec.Struct, array_like=True, frozen=True, tag="status"):
    """Status of the site; once a second. Replaced by a newer one.

    Attributes:
        site: site name.
        slot: newest closed slot.
        fps: slots per second, measured.
        lead: slots between an order and the slot it is for.
        people: people in that slot.
        cameras: all cameras of the rig, in its order.
        step_ms: median and 99th percentile of computing time per slot.
        latency_ms: median and 99th percentile from the last view's arrival to the poses.
        uptime_s: since the edge started.
        events: recent events, newest last.
        expected_error_mm: expected joint error; None if unknown.
        slots_lost: skipped slots.
        num_selected: cameras per slot of the policy; None if it has no number.
        target_error_mm: the error it aims at instead; None if it does not.
        quality_weight: its quality weight V; None if it has none.
        slots: slots computed since the edge started.
        blind: of these, blind slots by cause; causes that did not occur are absent.
        blind_share: blind slots, as a share of the last minute's slots.
        overload: what an overloaded edge says of itself; empty if it is not overloaded.
        events_ns: when each of `events` happened, by the edge's clock, nanoseconds since 1970.
        compiling_s: seconds until the edge has compiled its kernels, 0 while unknown; None if it
            has. Until then there are few slots a second, or none.
        check: what rests cost so far, and whether nobody rests because of it; empty while nothing
            is known.
        run_ns: when the run began that its slots and tracks belong to, nanoseconds since 1970:
            `started_ns` of the store's `runs`; 0 if unknown.
        spent_j: joules that slots since the edge started are charged with, all cameras together,
            blind slots left out.
        always_j: the same had all cameras been active in every slot.
        energy_measured: whether both are learned from meters; otherwise modelled.
        doubt: why scale or axes of the calibration cannot be right, as people show; empty if not.
    """

    site: str
    slot: Slot
    fps: Figure
    lead: Count
    people: Count
    cameras: tuple[CameraStatus, ...]
    # Below zero where a clock was set back meanwhile.
    step_ms: tuple[SignedFigure, SignedFigure] = (0.0, 0.0)
    latency_ms: tuple[SignedFigure, SignedFigure] = (0.0, 0.0)
    uptime_s: SignedFigure = 0.0
    events: tuple[str, ...] = ()
    expected_error_mm: Figure | None = None
    slots_lost: Count = 0
    num_selected: Figure | None = None
    target_error_mm: Figure | None = None
    quality_weight: Figure | None = None
    slots: Count = 0
    blind: dict[str, Count] = {}
    blind_share: Share = 0.0
    overload: str = ""
    events_ns: tuple[TimeNs, ...] = ()
    compiling_s: Figure | None = None
    check: str = ""
    run_ns: TimeNs = 0
    spent_j: Figure = 0.0
    always_j: Figure = 0.0
    energy_measured: bool = False
    doubt: str = ""
