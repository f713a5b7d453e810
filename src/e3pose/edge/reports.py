"""Messages of the edge to users: poses of a slot and status of the site."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.edge.camera_state import CameraState, asleep_s
from e3pose.edge.inbox import PAUSED
from e3pose.energy.saving import Savings, every_slot_cpu_s, saving
from e3pose.model.people import People
from e3pose.pipeline import SlotRecord
from e3pose.select.policies.base import Policy
from e3pose.wire.arrays import packed_people
from e3pose.wire.codec import one_line
from e3pose.wire.site_messages import CameraStatus, Poses, Status

if TYPE_CHECKING:
    from e3pose.base.clock import Clock, SlotTimes
    from e3pose.base.threads import ThreadGroup
    from e3pose.edge.camera_state import Answers
    from e3pose.edge.consumers import Consumers
    from e3pose.edge.counters import Counts
    from e3pose.edge.events import EventLog
    from e3pose.edge.gather import Gather
    from e3pose.edge.inbox import Inbox
    from e3pose.edge.lead import Lead
    from e3pose.edge.membership import Membership
    from e3pose.edge.overload import Load
    from e3pose.edge.precompile import Beside
    from e3pose.edge.send_queue import SendQueue
    from e3pose.edge.state_file import StateFile
    from e3pose.pipeline import Pipeline, SlotState
    from e3pose.settings.edge import EdgeSettings
    from e3pose.store.writer import WriterStatus


class RunningEdge(Protocol):
    """The parts of an edge that status and housekeeping use; see `EdgeServer`."""

    settings: EdgeSettings
    clock: Clock
    membership: Membership
    inbox: Inbox
    gather: Gather
    send_queue: SendQueue
    counts: Counts
    answers: Answers
    load: Load
    event_log: EventLog
    state_file: StateFile
    consumers: Consumers
    threads: ThreadGroup
    state: SlotState
    times: SlotTimes | None
    newest: SlotRecord | None
    ready: bool
    compiling: Beside | None
    started_ns: int

    @property
    def pipeline(self) -> Pipeline:
        """The parts of the loop in the next slot."""
        ...

    @property
    def lead(self) -> Lead:
        """The lead of the next slot."""
        ...

    def start_sending(self) -> None:
        """Start the thread that sends; it takes over from one that hangs."""
        ...

    def impairments(self) -> tuple[list[str], list[str]]:
        """Return why each camera is useless, and why it brings too few views; else empty."""
        ...


def poses_message(
    slot: int,
    people: People,
    joints: Sequence[str],
    time_ns: int,
    published_ns: int,
    selected: Sequence[str] = (),
    arrived: Sequence[str] = (),
    blind: str = "",
    stored: WriterStatus | None = None,
    delay_s: float = 0.0,
) -> Poses:
    """Return the message of a slot's people; `stored` is the stored range of slots.

    `delay_s` is how much later they are published, smoothed; 0 at once.
    """
    return Poses(
        slot,
        time_ns,
        tuple(joints),
        *packed_people(people),
        published_edge_ns=published_ns,
        selected=tuple(selected),
        arrived=tuple(arrived),
        blind=blind,
        stored_from=-1 if stored is None else stored.first_slot,
        stored_to=-1 if stored is None else stored.acknowledged_slot,
        store_shed=0 if stored is None else stored.shed,
        delay_ms=1e3 * delay_s,
    )


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
    every_s = every_slot_cpu_s(*work, slots, asleep_share)
    return None if every_s is None else 1 - beat.cpu_s / every_s


def savings(status: Status) -> Savings:
    """Return the savings of a site since its edge started."""
    known = [(c.cpu_s, c.cpu_saved) for c in status.cameras if c.cpu_s and c.cpu_saved is not None]
    every_s = [cpu_s / max(1 - (saved or 0.0), 1e-6) for cpu_s, saved in known]
    return Savings(
        saving(status.spent_j, status.always_j, status.energy_measured),
        saving([cpu_s for cpu_s, _ in known], every_s, measured=True),
    )


def camera_status(
    edge: RunningEdge, record: SlotRecord | None, index: int, problem: str, impairment: str
) -> CameraStatus:
    """Return the status of a camera.

    Args:
        edge: of the site.
        record: of the newest slot, the same for all cameras of a status.
        index: of the camera in the rig.
        problem: why it cannot be selected; empty if it can.
        impairment: why it is useless, or brings too little, although it can be selected.
    """
    camera, counts, now_ns = edge.inbox.cameras[index], edge.counts, edge.clock.now_ns()
    beat, capacity_wh = camera.beat, camera.hello.battery_wh if camera.hello else None
    late, turned = int(edge.gather.late[index]), edge.consumers.turned
    reasons = record.reasons if record else None
    occlusion = _at(index, record.occlusion if record else None)
    return CameraStatus(
        camera_id=camera.camera_id,
        online=not problem,
        title=edge.pipeline.rig.titles[camera.camera_id],
        why=one_line(problem or impairment),
        mode=beat.mode if beat else None,
        last_seen_s=None if camera.heard_ns is None else (now_ns - camera.heard_ns) / 1e9,
        duty=float(counts.duty()[index]),
        power_w=beat.power_w if beat else None,
        measured=bool(beat and beat.measured),
        battery=_share(beat.battery_j if beat else None, capacity_wh),
        deficit=float(edge.state.deficit[index]),
        late=late,
        lost=max(int(counts.missed[index]) - late, 0),
        clock_offset_ms=beat.clock_offset_ns / 1e6 if beat else 0.0,
        gauge=bool(beat and beat.gauge),
        noise_factor=_at(index, record.noise_factors if record else None),
        occlusion=None if occlusion is None else min(max(occlusion, 0.0), 1.0),
        gain_nats=_at(index, reasons.gain_nats if reasons else None),
        price=_at(index, reasons.price if reasons else None),
        temperature_c=beat.temperature_c if beat else None,
        focused=beat.focused if beat else 0,
        paused=problem == PAUSED,
        budget=min(max(float(edge.pipeline.queue.budget[index]), 0.0), 1.0),
        turned_deg=turned[1] if turned and turned[0] == index else None,
        ordered=int(counts.ordered[index]),
        delivered=edge.answers.delivery(index),
        source_fps=camera.frames_hz,
        asleep_s=asleep_s(camera, now_ns),
        wake_s=camera.wake.mean_s if camera.wake.wakes else None,
        cpu_s=beat.cpu_s if beat else None,
        cpu_saved=cpu_saved(camera, counts.interval_s, edge.lead.slots),
        unchanged=beat.unchanged / (beat.unchanged + beat.detected)
        if beat and beat.unchanged
        else None,
    )


def _at(camera: int, values: Floats | None) -> float | None:
    """Return the number of a camera; None where it is not known."""
    return float(values[camera]) if values is not None and np.isfinite(values[camera]) else None


def _share(charge_j: float | None, capacity_wh: float | None) -> float | None:
    """Return the state of charge in [0, 1]; None where it is not known."""
    if charge_j is None or not capacity_wh:
        return None
    return min(max(charge_j / (capacity_wh * 3600), 0.0), 1.0)


def site_status(edge: RunningEdge) -> Status:
    """Return the status message of a site."""
    record, counts, saved = edge.newest, edge.counts, edge.consumers.saving
    whys = zip(edge.inbox.problems(), *edge.impairments(), strict=True)
    cameras = tuple(
        camera_status(edge, record, index, problem, useless or short)
        for index, (problem, useless, short) in enumerate(whys)
    )
    now_ns, policy, events = edge.clock.now_ns(), edge.pipeline.policy, edge.event_log.recent
    target_m = _number(policy, "target_error_m")
    error_m = record.reasons.error_m if record and record.reasons else np.nan
    return Status(
        site=edge.settings.site,
        slot=record.slot if record else 0,
        fps=counts.fps(now_ns),
        lead=edge.lead.slots,
        people=len(record.people) if record else 0,
        cameras=cameras,
        step_ms=counts.stepping.median_and_99_ms(),
        latency_ms=counts.latency.median_and_99_ms(),
        uptime_s=(now_ns - edge.started_ns) / 1e9,
        events=tuple(one_line(event.message) for event in events),
        expected_error_mm=error_m * 1000 if np.isfinite(error_m) else None,
        slots_lost=counts.lost,
        num_selected=_number(policy, "num_selected"),
        target_error_mm=None if target_m is None else 1000 * target_m,
        quality_weight=_number(policy, "quality_weight"),
        compiling_s=None if edge.ready else _compiling_left_s(edge.compiling),
        slots=counts.slots,
        blind=counts.blind,
        blind_share=counts.blind_share(),
        overload=edge.load.message(),
        doubt=one_line(edge.consumers.doubt),
        check=record.reasons.check if record and record.reasons else "",
        events_ns=tuple(event.time_ns for event in events),
        run_ns=edge.state_file.run_ns,
        spent_j=saved.spent if saved else 0.0,
        always_j=saved.always if saved else 0.0,
        energy_measured=bool(saved and saved.basis == "measured"),
    )


def _compiling_left_s(beside: Beside | None) -> float:
    """Return the seconds until all kernels are compiled; 0 while that is unknown.

    It imports nothing: another thread may be importing numba just now.
    """
    if beside is not None:
        return beside.left_s()
    compiling = getattr(sys.modules.get("e3pose.base.compiling"), "COMPILING", None)
    return (compiling.left_s() or 0.0) if compiling is not None and compiling.begun else 0.0


def _number(policy: Policy, name: str) -> float | None:
    """Return a numeric setting of a policy; None if it has none of that name."""
    found = getattr(policy, name, None)
    return float(found) if isinstance(found, int | float) and np.isfinite(found) else None


# Of each camera: why it cannot be selected, why it is useless, and why it brings too few views.
Conditions = tuple[Sequence[str], Sequence[str], Sequence[str]]


def camera_changes(
    titles: Mapping[str, str], before: Conditions, after: Conditions
) -> list[tuple[str, str, str]]:
    """Return the events of cameras that were lost, respond too late, bring too few, or recover."""
    lost = changes(titles, before[0], after[0], ("camera-lost", "camera-back"))
    kinds = "camera-useless", "camera-useful"
    useless = changes(titles, before[1], after[1], kinds, "responds in time again")
    kinds = "camera-short", "camera-enough"
    well = "brings the views ordered of it again"
    return lost + useless + changes(titles, before[2], after[2], kinds, well)


def changes(
    titles: Mapping[str, str],
    before: Sequence[str],
    after: Sequence[str],
    kinds: tuple[str, str],
    well: str = "connected",
) -> list[tuple[str, str, str]]:
    """Return the events of cameras whose problem began or ended: kind, message, camera.

    Args:
        titles: of the cameras of the rig, by id.
        before: the problem of each; empty where there was none.
        after: likewise, now.
        kinds: of events, for a problem that begins and one that ends.
        well: message when a problem ends.
    """
    return [
        (kinds[not why], f"{title}: {why}" if why else f"{title} {well}", camera_id)
        for (camera_id, title), was, why in zip(titles.items(), before, after, strict=True)
        if bool(was) != bool(why)
    ]
