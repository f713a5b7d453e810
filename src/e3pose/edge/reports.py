"""Messages of the edge to users: poses of a slot and status of the site."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.edge.counters import Counts
from e3pose.edge.health import Health
from e3pose.edge.inbox import PAUSED
from e3pose.edge.rests import Rests, WakeTime
from e3pose.edge.roster import CameraState
from e3pose.energy.processor_time import share_saved
from e3pose.estimate.base import People
from e3pose.model.uncertainty import axis_sigma_m
from e3pose.pipeline import Pipeline, SlotRecord
from e3pose.select.policies.base import Policy
from e3pose.store.rows import Event
from e3pose.wire.arrays import pack
from e3pose.wire.codec import one_line
from e3pose.wire.site_messages import CameraStatus, Poses, Status

if TYPE_CHECKING:
    from e3pose.store.writer import WriterStatus


def poses_message(
    slot: int,
    people: People | SlotRecord,
    joints: Sequence[str],
    time_ns: int,
    published_ns: int,
    selected: Sequence[str] = (),
    arrived: Sequence[str] = (),
    blind: str = "",
    stored: WriterStatus | None = None,
    delay_s: float = 0.0,
) -> Poses:
    """Return the message of a slot's people; `stored` says what the store holds.

    `delay_s` is how much later they are published, smoothed; 0 at once.
    """
    return Poses(
        slot=slot,
        time_edge_ns=time_ns,
        joints=tuple(joints),
        track_ids=pack(people.track_ids.astype(np.int64)),
        joints_m=pack(people.poses.joints_m.astype(np.float32)),
        sigma_m=pack(axis_sigma_m(people.covariance_m2).astype(np.float32)),
        measured=pack(np.asarray(people.measured, dtype=bool)),
        published_edge_ns=published_ns,
        selected=tuple(selected),
        arrived=tuple(arrived),
        blind=blind,
        stored_from=-1 if stored is None else stored.first_slot,
        stored_to=-1 if stored is None else stored.acknowledged_slot,
        store_shed=0 if stored is None else stored.shed,
        delay_ms=1e3 * delay_s,
    )


class ShownReason(NamedTuple):
    """What a camera was expected to show in the newest decided slot; None if unknown."""

    occlusion: float | None = None
    gain_nats: float | None = None
    price: float | None = None


NOTHING = ShownReason()


def shown_reason(record: SlotRecord | None, camera: int) -> ShownReason:
    """Return what the newest record expected a camera to show."""
    if record is None:
        return NOTHING
    occlusion, reasons = float(record.occlusion[camera]), record.reasons
    found = ShownReason(min(max(occlusion, 0.0), 1.0) if np.isfinite(occlusion) else None)
    if reasons is None:
        return found
    gain, price = float(reasons.gain_nats[camera]), float(reasons.price[camera])
    return found._replace(
        gain_nats=gain if np.isfinite(gain) else None, price=price if np.isfinite(price) else None
    )


def camera_status(
    camera: CameraState,
    problem: str,
    impairment: str,
    deficit: float,
    duty: float,
    late: int,
    lost: int,
    now_ns: int,
    noise_factor: float = np.nan,
    shift_px: float = np.nan,
    why: ShownReason = NOTHING,
    budget: float | None = None,
    turned_deg: float | None = None,
    ordered: int = 0,
    delivered: float | None = None,
    asleep_s: float | None = None,
    wake: WakeTime | None = None,
    interval_s: float = 0.0,
    lead_slots: int = 0,
) -> CameraStatus:
    """Return the status of a camera.

    Args:
        camera: its state.
        problem: why it cannot be selected; empty if it can.
        impairment: why it is useless although it can be selected; empty if it is useful.
        deficit: its virtual queue.
        duty: share of the last minute's slots in which it was selected.
        late: views that arrived too late.
        lost: views that were ordered and never arrived.
        now_ns: the time.
        noise_factor: sigma of its keypoints relative to the noise file; NaN if unknown.
        shift_px: common offset of all its keypoints; NaN if unknown.
        why: it was or was not selected.
        budget: share of the slots in which it may be active.
        turned_deg: rotation since its calibration; None if it was not turned.
        ordered: views ordered in time.
        delivered: share of the newest of these that arrived; None if unknown.
        asleep_s: until it is expected back; None while it is awake.
        wake: what it takes to wake, as learned.
        interval_s: seconds per slot; 0 where it does not matter.
        lead_slots: between an order and its slot.
    """
    beat, capacity_wh = camera.beat, camera.hello.battery_wh if camera.hello else None
    charge = beat.battery_j if beat else None
    return CameraStatus(
        camera_id=camera.camera_id,
        online=not problem,
        why=one_line(problem or impairment),
        mode=beat.mode if beat else None,
        last_seen_s=None if camera.heard_ns is None else (now_ns - camera.heard_ns) / 1e9,
        duty=duty,
        power_w=beat.power_w if beat else None,
        measured=bool(beat and beat.measured),
        battery=_share(charge, capacity_wh),
        deficit=float(deficit),
        late=late,
        lost=lost,
        clock_offset_ms=beat.clock_offset_ns / 1e6 if beat else 0.0,
        gauge=bool(beat and beat.gauge),
        noise_factor=float(noise_factor) if np.isfinite(noise_factor) else None,
        shift_px=float(shift_px) if np.isfinite(shift_px) else None,
        occlusion=why.occlusion,
        gain_nats=why.gain_nats,
        price=why.price,
        temperature_c=beat.temperature_c if beat else None,
        focused=beat.focused if beat else 0,
        paused=problem == PAUSED,
        budget=None if budget is None else min(max(budget, 0.0), 1.0),
        turned_deg=turned_deg,
        ordered=ordered,
        delivered=delivered,
        source_fps=camera.frames_hz,
        asleep_s=asleep_s,
        wake_s=wake.mean_s if wake is not None and wake.wakes else None,
        cpu_s=beat.cpu_s if beat else None,
        cpu_saved=cpu_saved(camera, interval_s, lead_slots),
    )


def _share(charge_j: float | None, capacity_wh: float | None) -> float | None:
    """Return the state of charge in [0, 1]; None where it is not known."""
    if charge_j is None or not capacity_wh:
        return None
    return min(max(charge_j / (capacity_wh * 3600), 0.0), 1.0)


def cpu_saved(camera: CameraState, interval_s: float, lead_slots: int) -> float | None:
    """Return the share of processor time that a camera saves; None where it is not known.

    It could have looked in the slots that it had orders for, and in those of its sleep.
    """
    beat = camera.beat
    if beat is None or beat.cpu_s is None or not interval_s:
        return None
    span_s = beat.active_s + beat.idle_s + beat.asleep_s
    heard = max(beat.orders - lead_slots, 0)
    slots = max(heard, min(span_s, heard * interval_s + beat.asleep_s) / interval_s)
    asleep_share = beat.asleep_s / span_s if span_s else 0.0
    work = beat.cpu_s, beat.look_cpu_s, beat.detected, beat.captured
    return share_saved(*work, slots, asleep_share)


def site_cpu_saved(status: Status) -> float | None:
    """Return the share of processor time that all cameras save; None where it is known of none."""
    known = [(c.cpu_s, c.cpu_saved) for c in status.cameras if c.cpu_s and c.cpu_saved is not None]
    every_s = sum(cpu_s / max(1 - (saved or 0.0), 1e-6) for cpu_s, saved in known)
    return 1 - sum(cpu_s for cpu_s, _ in known) / every_s if known else None


@dataclass(frozen=True, slots=True, eq=False)
class SiteSnapshot:
    """The state of a site at one time.

    Attributes:
        site: its name.
        now_ns: the time.
        uptime_s: since the edge started.
        record: of the newest slot, if there is one.
        cameras: `(num_cameras,)` of the cameras.
        problems: `(num_cameras,)` why each cannot be selected; empty if it can.
        impairments: `(num_cameras,)` why each is useless, or brings too little, although it can be
            selected.
        health: of the edge, and what the cameras deliver.
        deficit: `(num_cameras,)` their virtual queues.
        late: `(num_cameras,)` views that arrived too late.
        lead_slots: between an order and its slot.
        pipeline: the current parts.
        counts: of slots, views and times.
        events: the latest.
        rests: who sleeps by order.
        turned: index of a knocked camera, and degrees; None if there is none.
        compiling_s: until all kernels are compiled; None if they are.
    """

    site: str
    now_ns: int
    uptime_s: float
    record: SlotRecord | None
    cameras: Sequence[CameraState]
    problems: Sequence[str]
    impairments: Sequence[str]
    health: Health
    deficit: NDArray[np.float64]
    late: NDArray[np.int64]
    lead_slots: int
    pipeline: Pipeline
    counts: Counts
    events: Sequence[Event]
    rests: Rests
    turned: tuple[int, float] | None = None
    compiling_s: float | None = None


def site_status(snapshot: SiteSnapshot) -> Status:
    """Return the status message of a site."""
    record, counts = snapshot.record, snapshot.counts
    factors = record.noise_factors if record else None
    if factors is None:
        factors = np.full(len(snapshot.cameras), np.nan)
    shifts_px = record.shifts_px if record else None
    if shifts_px is None:
        shifts_px = np.full((len(snapshot.cameras), 2), np.nan)
    duty = counts.duty()
    cameras = tuple(
        camera_status(
            camera,
            snapshot.problems[index],
            snapshot.impairments[index],
            snapshot.deficit[index],
            float(duty[index]),
            int(snapshot.late[index]),
            max(int(counts.missed[index] - snapshot.late[index]), 0),
            snapshot.now_ns,
            factors[index],
            float(np.hypot(*shifts_px[index])),
            shown_reason(record, index),
            float(snapshot.pipeline.queue.budget[index]),
            snapshot.turned[1] if snapshot.turned and snapshot.turned[0] == index else None,
            int(counts.ordered[index]),
            snapshot.health.delivery.share(index),
            snapshot.rests.left_s(index, camera, snapshot.now_ns),
            snapshot.rests.wakes[index],
            counts.interval_s,
            snapshot.lead_slots,
        )
        for index, camera in enumerate(snapshot.cameras)
    )
    policy = snapshot.pipeline.policy
    target_m = _number(policy, "target_error_m")
    error_m = record.reasons.error_m if record and record.reasons else np.nan
    return Status(
        site=snapshot.site,
        slot=record.slot if record else 0,
        fps=counts.fps(snapshot.now_ns),
        lead=snapshot.lead_slots,
        people=len(record.track_ids) if record else 0,
        cameras=cameras,
        step_ms=counts.stepping.median_and_99_ms(),
        latency_ms=counts.latency.median_and_99_ms(),
        uptime_s=snapshot.uptime_s,
        events=tuple(one_line(event.message) for event in snapshot.events),
        expected_error_mm=error_m * 1000 if np.isfinite(error_m) else None,
        slots_lost=counts.lost,
        num_selected=_number(policy, "num_selected"),
        target_error_mm=None if target_m is None else 1000 * target_m,
        quality_weight=_number(policy, "quality_weight"),
        compiling_s=snapshot.compiling_s,
        slots=counts.slots,
        blind=counts.blind,
        blind_share=counts.blind_share(),
        overload=snapshot.health.load.words(),
        check=record.reasons.check if record and record.reasons else "",
        events_ns=tuple(event.time_ns for event in snapshot.events),
    )


def _number(policy: Policy, name: str) -> float | None:
    """Return a numeric setting of a policy; None if it has none of that name."""
    found = getattr(policy, name, None)
    return float(found) if isinstance(found, int | float) and np.isfinite(found) else None


# Of each camera: why it cannot be selected, why it is useless, and why it brings too few views.
Conditions = tuple[Sequence[str], Sequence[str], Sequence[str]]


def camera_changes(
    camera_ids: Sequence[str], before: Conditions, after: Conditions
) -> list[tuple[str, str, str]]:
    """Return the events of cameras that were lost, respond too late, bring too few, or recover."""
    lost = changes(camera_ids, before[0], after[0], ("camera-lost", "camera-back"))
    kinds = "camera-useless", "camera-useful"
    useless = changes(camera_ids, before[1], after[1], kinds, "responds in time again")
    kinds = "camera-short", "camera-enough"
    well = "brings the views ordered of it again"
    return lost + useless + changes(camera_ids, before[2], after[2], kinds, well)


def changes(
    camera_ids: Sequence[str],
    before: Sequence[str],
    after: Sequence[str],
    kinds: tuple[str, str],
    well: str = "connected",
) -> list[tuple[str, str, str]]:
    """Return the events of cameras whose problem began or ended: kind, message, camera.

    Args:
        camera_ids: of the rig.
        before: the problem of each; empty where there was none.
        after: likewise, now.
        kinds: of events, for a problem that begins and one that ends.
        well: message when a problem ends.
    """
    return [
        (kinds[not why], f"{camera_id}: {why}" if why else f"{camera_id} {well}", camera_id)
        for camera_id, was, why in zip(camera_ids, before, after, strict=True)
        if bool(was) != bool(why)
    ]
