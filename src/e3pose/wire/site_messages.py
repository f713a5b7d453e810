"""Messages of a site to its users and operators: poses, status, control, pictures.

Append fields only, with defaults, as in `messages`.
"""

from __future__ import annotations

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
from e3pose.wire.messages import Activity, Array


class Poses(msgspec.Struct, array_like=True, frozen=True, tag="poses"):
    """The people of one slot, for subscribers.

    Replaced by a newer one.

    Attributes:
        slot: which.
        time_edge_ns: when the slot was.
        joints: names of the joints, in order.
        track_ids: `(num_persons,)` i8.
        joints_m: `(num_persons, num_joints, 3)` f4 world metres; NaN where unknown.
        sigma_m: `(num_persons, num_joints)` f4 standard deviation along an axis; NaN where unknown.
        measured: `(num_persons, num_joints)` b1; the others are predicted from earlier slots.
        published_edge_ns: when the message left.
        selected: cameras selected for the slot; empty for delayed poses.
        arrived: those of them whose views are in the poses.
        blind: why no view arrived although one was due, one of `blind_slot.CAUSES`; empty if the
            slot is not blind.
        stored_from: oldest slot of this edge program that its store holds or is to hold; -1 where
            nothing is stored yet, and for delayed poses.
        stored_to: newest slot up to which the store holds all that were published from
            `stored_from` on; smaller than `stored_from` while it holds none.
        store_shed: records that the store gave up since the edge was started.
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


class CameraStatus(msgspec.Struct, array_like=True, frozen=True):
    """The status of a camera.

    Attributes:
        camera_id: of the camera.
        online: whether it can be selected.
        why: why it is not; else its impairment.
        mode: of its last heartbeat.
        last_seen_s: seconds since its last message; None if never.
        duty: share of the last minute's slots in which it was selected, blind slots left out.
        power_w: reported power.
        measured: whether that was measured.
        battery: state of charge in [0, 1]; None on mains or where unknown.
        deficit: its energy deficit queue.
        late: views that arrived after their slot was closed, since the start.
        lost: views that were ordered and never arrived.
        clock_offset_ms: edge time minus camera time.
        gauge: whether a gauge measures `battery`; otherwise a model estimates it.
        noise_factor: sigma of its keypoints over the noise file's, as learned; None if unknown.
        occlusion: of the people in its view, predicted for the slot decided last, [0, 1].
        gain_nats: information per joint that it adds to the others; None if not computed.
        price: of its energy queue, on the same scale.
        temperature_c: of the device, by its own sensor; None where there is none.
        paused: whether an operator paused it.
        budget: share of the slots in which it may be active, as a mean.
        turned_deg: lower bound of its rotation since calibration; None if none is detected.
        focused: frames with an expected view, since it started.
        ordered: views ordered in time, since the edge was started.
        delivered: share of the newest of these that arrived in time, [0, 1]; None while they are
            too few.
        source_fps: frames per second that its source brings, measured; None where unknown.
        asleep_s: seconds until it is expected back from a sleep that it was told to take; negative
            while it oversleeps, None while it is awake.
        wake_s: what it takes to wake, mean as the edge learned it; None before its first wake.
        cpu_s: processor time of its program since it started to capture; None where unknown.
        cpu_saved: processor time saved, as a share of what looking in every slot would take, by
            its own time of a look and of a frame, [0, 1]; None while too little is known.
        unchanged: share of its looks for which its image was unchanged, so that the network did
            not run, [0, 1]; None without any.
    """

    camera_id: str
    online: bool
    why: str = ""
    mode: Activity | None = None
    last_seen_s: SignedFigure | None = None
    duty: Share = 0.0
    power_w: Figure | None = None
    measured: bool = False
    battery: Share | None = None
    deficit: SignedFigure = 0.0
    late: Count = 0
    lost: Count = 0
    clock_offset_ms: SignedFigure = 0.0
    gauge: bool = False
    noise_factor: float | None = None
    occlusion: Share | None = None
    gain_nats: SignedFigure | None = None
    price: SignedFigure | None = None
    temperature_c: TemperatureC | None = None
    paused: bool = False
    budget: Share | None = None
    turned_deg: float | None = None
    focused: Count = 0
    ordered: Count = 0
    delivered: Share | None = None
    source_fps: Figure | None = None
    asleep_s: SignedFigure | None = None
    wake_s: Figure | None = None
    cpu_s: Figure | None = None
    cpu_saved: Share | None = None
    unchanged: Share | None = None


class Control(msgspec.Struct, array_like=True, frozen=True, tag="control"):
    """Request of an operator to change settings of the running edge, until it restarts.

    What is None or empty stays as it is.

    Attributes:
        cameras: cameras per slot, as a mean; ends aiming at an error.
        target_error_mm: wake as few as keep the expected error below this; in place of `cameras`.
        quality_weight: the paper's V.
        camera_id: of the camera that the rest is about.
        paused: whether that camera is left out.
        budget: what it may spend, as people write it: `60%`, `4W`, `until 18:00`.
        reread: take zones, the usual budget and what is kept from the site file as it is now.
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
        said: what it does, for operators; empty if it refuses.
        problem: why it refuses; empty where it does not.
    """

    said: str = ""
    problem: str = ""


class PictureQuestion(msgspec.Struct, array_like=True, frozen=True, tag="picture-question"):
    """Request of an operator to see the newest image in which a camera detected.

    Attributes:
        have_ns: `captured_edge_ns` of the picture that the operator has; it is not sent again.
        large: whether a larger picture is asked for.
    """

    have_ns: TimeNs = 0
    large: bool = False


class Picture(msgspec.Struct, array_like=True, frozen=True, tag="picture"):
    """The newest image in which a camera detected, for an operator.

    Attributes:
        camera_id: of the camera.
        slot: in which it detected in that image.
        image_size: `(width, height)` in pixels of the image it looked at.
        jpeg: of the image, made small; empty if there is none, or the operator has it.
        count: pictures made since its program started.
        energy_j: modelled energy of making them, all of them together.
        captured_edge_ns: when the image was captured, by the edge's clock.
        drawn: whether it is drawn from keypoints, as the source has no images.
        why: there is no picture; empty if there is one.
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


class OutboxQuestion(msgspec.Struct, array_like=True, frozen=True, tag="outbox-question"):
    """Request of a hub for summaries of the site.

    Attributes:
        after: the number up to which it has them.
    """

    after: Count = 0


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
        begun_ns: when the outbox was begun: another value is another outbox.
        newest: the number given last.
        shed: summaries up to this number had to make room.
        rows: JSON list of summaries after the number asked for, oldest first, as many as fit.
        problem: why there are none; empty where there is no problem.
        forgotten: what was deleted after the number asked for and before that of the last row.
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
        site: its name.
        slot: the newest slot that was closed.
        fps: slots per second, measured.
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
        slots: that were computed since the edge was started.
        blind: of these, blind slots by cause, one of `blind_slot.CAUSES`.
        blind_share: of the last minute's slots, [0, 1].
        overload: that the edge is too slow for its slots, for operators; empty if it is not.
        events_ns: when each of `events` happened, by the edge's clock.
        compiling_s: seconds until the kernels are compiled, 0 while unknown; None if they are.
        check: the cost of rests so far, for operators; empty while that is unknown.
        run_ns: when the run began that its slots and tracks belong to, as the store names it.
        spent_j: joules that slots since the edge was started are charged with, all cameras
            together, blind slots left out.
        always_j: likewise, had all cameras been active in every slot.
        energy_measured: whether both are learned from meters; otherwise a model says so.
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
