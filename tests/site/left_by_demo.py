"""What a live site of the demo leaves, without its processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.energy.budgets import Budget
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.camera import Rig
from e3pose.model.people import People
from e3pose.model.skeleton import skeleton_by_name
from e3pose.pipeline import SlotRecord
from e3pose.recording import load_recording
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import load_site
from e3pose.site.demo.live import Heard, HeardView, Show
from e3pose.store import Run, StoreWriter
from e3pose.wire.messages import Heartbeat
from e3pose.wire.site_messages import CameraStatus, Status

BEGIN_NS = 1_795_000_000_000_000_000


def canned(
    site_file: Path, rig: Rig, num_slots: int, round_s: float, ready_s: float, show: Show
) -> Heard:
    """Leave what a live site leaves, one slot a frame from the beginning on, without processes."""
    site = load_site(site_file)
    slot_ns = round(1e9 / site.fps / site.pace)
    skeleton = skeleton_by_name(site.skeleton_name or "")
    assert round_s == pytest.approx(num_slots * slot_ns / 1e9)
    heard = Heard(begin_ns=BEGIN_NS, slots=num_slots)
    recorded = site_file.parent / "recording"
    if recorded.is_dir():
        recording = load_recording(recorded)
        settings = ReplaySettings(num_selected=2)
        records = list(replay(recording, settings))
        for record in records:
            for index in np.flatnonzero(record.arrived):
                view = recording.view(record.slot, int(index))
                assert view is not None
                key = (record.slot, rig.camera_ids[index])
                heard.views[key] = HeardView(view, BEGIN_NS + record.slot * slot_ns)
    else:
        records = [nobody(slot, 1 / site.fps, len(rig)) for slot in range(heard.slots + 3)]
    for camera_id in rig.camera_ids:
        heard.sent_bytes[camera_id] = 500
        heard.beats[camera_id] = Heartbeat(camera_id, 1, 0, "active", orders=20, late_orders=1)
    run = Run(
        site.name, site.name, BEGIN_NS, 1 / site.fps, skeleton.name, skeleton.joints, rig.camera_ids
    )
    ledger = ledger_of(site_file)
    with StoreWriter(site_file.parent / "live.db", run) as writer:
        for record in records:
            joules = ledger.charge(record.selected, blind=bool(record.blind))
            writer.append(record, time_ns=BEGIN_NS + record.slot * slot_ns, energy_j=joules)
    saved = ledger.saving()
    assert saved is not None
    looked = [CameraStatus(one, True, cpu_s=6.0, cpu_saved=0.2927) for one in rig.camera_ids]
    heard.status = Status(
        site.name, heard.slots - 1, site.fps, 2, 2, tuple(looked), latency_ms=(1.0, 2.0),
        spent_j=saved.spent, always_j=saved.always,
    )  # fmt: skip
    show(heard.status, heard.slots, heard.slots)
    return heard


def ledger_of(site_file: Path) -> EnergyLedger:
    """Return the ledger of a site whose cameras have no meter."""
    site = resolve_site(site_file)
    ids, profiles = site.rig.camera_ids, site.plan.profiles
    modes, budgets = [site.plan.idle_mode] * len(ids), [Budget("duty", 1.0)] * len(ids)
    return EnergyLedger(ids, profiles, modes, budgets, site.interval_s, 2.0, lambda: BEGIN_NS)


def nobody(slot: int, interval_s: float, num_cameras: int) -> SlotRecord:
    flags, zeros = np.ones(num_cameras, dtype=bool), np.zeros(num_cameras)
    people = People.empty(18)
    return SlotRecord(slot, slot * interval_s, flags, flags, people, zeros, zeros, flags)
