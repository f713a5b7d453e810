"""Messages of the edge to users: poses of a slot and status of the site."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.edge.counters import Counts
from e3pose.edge.inbox import PAUSED
from e3pose.edge.roster import CameraLife
from e3pose.estimate.base import People
from e3pose.model.uncertainty import axis_sigma_m
from e3pose.pipeline import Pipeline, SlotRecord
from e3pose.select.policies.base import Policy
from e3pose.wire.arrays import pack
from e3pose.wire.codec import one_line
from e3pose.wire.site_messages import CameraStatus, Poses, Status


def poses_message(
    slot: int,
    people: People,
    joints: Sequence[str],
    time_ns: int,
    published_ns: int,
    selected: Sequence[str] = (),
    arrived: Sequence[str] = (),
) -> Poses:
    """Return the message of a slot's people."""
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
    )


class Outlined(NamedTuple):
    """What a camera was expected to show in the slot decided last; None if unknown."""

    occlusion: float | None = None
    gain_nats: float | None = None
    price: float | None = None


NOTHING = Outlined()


def outlined(record: SlotRecord | None, camera: int) -> Outlined:
    """Return what a camera was expected to show, by the newest record."""
    if record is None:
        return NOTHING
    occlusion, reasons = float(record.occlusion[camera]), record.reasons
    found = Outlined(min(max(occlusion, 0.0), 1.0) if np.isfinite(occlusion) else None)
    if reasons is None:
        return found
    gain, price = float(reasons.gain_nats[camera]), float(reasons.price[camera])
    return found._replace(
        gain_nats=gain if np.isfinite(gain) else None, price=price if np.isfinite(price) else None
    )


def camera_status(
    life: CameraLife,
    trouble: str,
    oddity: str,
    deficit: float,
    duty: float,
    late: int,
    lost: int,
    now_ns: int,
    noise_factor: float = np.nan,
    shift_px: float = np.nan,
    why: Outlined = NOTHING,
    budget: float | None = None,
    turned_deg: float | None = None,
) -> CameraStatus:
    """Return what the edge knows of a camera.

    Args:
        life: of the camera.
        trouble: why it cannot be chosen; empty if it can.
        oddity: why it is of no use all the same.
        deficit: its queue.
        duty: share of the last minute's slots in which it was selected.
        late: views that came too late.
        lost: views that were ordered and never came.
        now_ns: the time.
        noise_factor: sigma of its keypoints over what the noise file states; NaN if unknown.
        shift_px: how far all of its keypoints are off the same way; NaN if unknown.
        why: it was or was not selected.
        budget: share of the slots in which it may be active.
        turned_deg: by how much it was turned since it was calibrated; None if it was not.
    """
    beat, capacity_wh = life.beat, life.hello.battery_wh if life.hello else None
    charge = beat.battery_j if beat else None
    return CameraStatus(
        camera_id=life.camera_id,
        online=not trouble,
        why=one_line(trouble or oddity),
        mode=beat.mode if beat else None,
        last_seen_s=None if life.heard_ns is None else (now_ns - life.heard_ns) / 1e9,
        duty=duty,
        power_w=beat.power_w if beat else None,
        measured=bool(beat and beat.measured),
        battery=(
            None
            if charge is None or not capacity_wh
            else min(max(charge / (capacity_wh * 3600), 0.0), 1.0)
        ),
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
        paused=trouble == PAUSED,
        budget=None if budget is None else min(max(budget, 0.0), 1.0),
        turned_deg=turned_deg,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What an edge knows of its site at one time.

    Attributes:
        site: its name.
        now_ns: the time.
        uptime_s: since it began.
        record: of the newest slot, if there is one.
        lives: `(num_cameras,)` of the cameras.
        troubles: `(num_cameras,)` why each cannot be chosen; empty if it can.
        oddities: `(num_cameras,)` why each is of no use all the same.
        deficit: `(num_cameras,)` their queues.
        late: `(num_cameras,)` views that came too late.
        lead_slots: between an order and its slot.
        pipeline: the parts that work now.
        counts: of slots, views and times.
        events: what was told last.
        turned: index of a camera that was knocked, and degrees; None if none was.
    """

    site: str
    now_ns: int
    uptime_s: float
    record: SlotRecord | None
    lives: Sequence[CameraLife]
    troubles: Sequence[str]
    oddities: Sequence[str]
    deficit: NDArray[np.float64]
    late: NDArray[np.int64]
    lead_slots: int
    pipeline: Pipeline
    counts: Counts
    events: Sequence[str]
    turned: tuple[int, float] | None = None


def site_status(moment: Moment) -> Status:
    """Return how a site is."""
    record, counts = moment.record, moment.counts
    factors = record.noise_factors if record else None
    if factors is None:
        factors = np.full(len(moment.lives), np.nan)
    shifts_px = record.shifts_px if record else None
    if shifts_px is None:
        shifts_px = np.full((len(moment.lives), 2), np.nan)
    duty = counts.duty()
    cameras = tuple(
        camera_status(
            life,
            moment.troubles[index],
            moment.oddities[index],
            moment.deficit[index],
            float(duty[index]),
            int(moment.late[index]),
            max(int(counts.missed[index] - moment.late[index]), 0),
            moment.now_ns,
            factors[index],
            float(np.hypot(*shifts_px[index])),
            outlined(record, index),
            float(moment.pipeline.budget[index]),
            moment.turned[1] if moment.turned and moment.turned[0] == index else None,
        )
        for index, life in enumerate(moment.lives)
    )
    policy = moment.pipeline.policy
    target_m = _number(policy, "target_error_m")
    error_m = record.reasons.error_m if record and record.reasons else np.nan
    return Status(
        site=moment.site,
        slot=record.slot if record else 0,
        fps=counts.fps(moment.now_ns),
        lead=moment.lead_slots,
        people=len(record.track_ids) if record else 0,
        cameras=cameras,
        step_ms=counts.stepping.median_and_99_ms(),
        latency_ms=counts.latency.median_and_99_ms(),
        uptime_s=moment.uptime_s,
        events=tuple(map(one_line, moment.events)),
        expected_error_mm=error_m * 1000 if np.isfinite(error_m) else None,
        slots_lost=counts.lost,
        num_selected=_number(policy, "num_selected"),
        target_error_mm=None if target_m is None else 1000 * target_m,
        quality_weight=_number(policy, "quality_weight"),
    )


def _number(policy: Policy, name: str) -> float | None:
    """Return a number that a policy has; None of one that has none by that name."""
    found = getattr(policy, name, None)
    return float(found) if isinstance(found, int | float) and np.isfinite(found) else None


def changes(
    camera_ids: Sequence[str],
    before: Sequence[str],
    after: Sequence[str],
    kinds: tuple[str, str],
    well: str = "connected",
) -> list[tuple[str, str, str]]:
    """Return what to tell of cameras whose trouble began or ended: kind, words, camera.

    Args:
        camera_ids: of the rig.
        before: what troubled each; empty where nothing did.
        after: what does now.
        kinds: of events, when it begins and when it ends.
        well: what to say of a camera when its trouble ends.
    """
    return [
        (kinds[not why], f"{camera_id}: {why}" if why else f"{camera_id} {well}", camera_id)
        for camera_id, was, why in zip(camera_ids, before, after, strict=True)
        if bool(was) != bool(why)
    ]
