"""What a live site leaves, without its processes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.energy.budgets import Budget
from e3pose.energy.saving import Saving
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.people import People
from e3pose.model.skeleton import load_skeleton
from e3pose.pipeline import SlotRecord
from e3pose.recording import load_recording
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import load_site
from e3pose.store import Run, StoreWriter
from e3pose.wire.site_messages import CameraStatus, Status

BEGIN_NS = 1_795_000_000_000_000_000


def leave(site_file: Path) -> Status:
    """Leave what a live site leaves in its store, one slot a frame; return its last status."""
    site = load_site(site_file)
    slot_ns = round(1e9 / site.fps / site.pace)
    skeleton = load_skeleton(site.skeleton_name or "")
    recording = load_recording(site_file.parent / "recording")
    ids = recording.rig.camera_ids
    run = Run(site.name, site.name, BEGIN_NS, 1 / site.fps, skeleton.name, skeleton.joints, ids)
    ledger = ledger_of(site_file)
    with StoreWriter(site_file.parent / "live.db", run) as writer:
        for record in replay(recording, ReplaySettings(num_selected=2)):
            joules = ledger.charge(record.selected, blind=bool(record.blind))
            writer.append(record, time_ns=BEGIN_NS + record.slot * slot_ns, energy_j=joules)
    return status_of(site.name, recording.num_slots, ids, ledger.saving())


def status_of(name: str, slots: int, ids: Sequence[str], saved: Saving | None) -> Status:
    """Return the status of a site after so many slots."""
    looked = tuple(CameraStatus(one, True, cpu_s=6.0, cpu_saved=0.2927) for one in ids)
    spent, always = (0.0, 0.0) if saved is None else (saved.spent, saved.always)
    return Status(
        name, slots, 20.0, 2, 2, looked, latency_ms=(1.0, 2.0), spent_j=spent, always_j=always
    )


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
