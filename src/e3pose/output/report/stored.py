"""The report of a time range of a live store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from datetime import datetime, timezone
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.estimate.smooth import SmoothSettings
from e3pose.evaluate.smoothed import smooth_poses
from e3pose.evaluate.summary import summarise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import skeleton_by_name
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report.page import write_report
from e3pose.output.report.site_films import filmed, processor_of
from e3pose.recording import Recording, ViewSeries
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.resolved import ResolvedSite
from e3pose.store import Store
from e3pose.store.query import Time
from e3pose.store.records import charged_j, slot_records

AS_STORED = SmoothSettings()
ADAPTIVE = "adaptive: follows the delays"
MOST_SLOTS = 200_000  # of a page: two hours at 25 slots per second


def write_stretch(
    site: ResolvedSite,
    store: Store,
    path: Path,
    start: Time = None,
    end: Time = None,
    smoothing: SmoothSettings = AS_STORED,
    asked_run: int | None = None,
) -> int:
    """Write the page of a site's stored slots between two times; return how many it shows.

    It shows the newest run of that time, with the videos that the site kept.

    Args:
        site: the site, whose cameras are drawn where its calibration has them now.
        store: its store.
        path: the `.html` file to write.
        start, end: see `Store.query`.
        smoothing: of the poses.
        asked_run: the run to show, in place of the newest.

    Raises:
        InputError: when nothing was stored in that time, too much for a page, or of other cameras.
    """
    ids = site.rig.camera_ids
    runs = [
        one
        for one in store.runs()
        if one.run.site == site.file.name and asked_run in (None, one.run_id)
    ]
    for run in reversed(runs):
        rows = store.rows("slots", start, end, run=run.run_id)
        if rows:
            break
    else:
        raise InputError(f"{store.where}: no slot of site {site.file.name} was stored in that time")
    if len(rows) > MOST_SLOTS:
        slots = plural(len(rows), "slot")
        raise InputError("time", slots, f"at most {MOST_SLOTS}: name a shorter time", store.where)
    if tuple(run.run.cameras) != ids:
        found = f"slots of cameras {', '.join(run.run.cameras)[:200]}"
        raise InputError("calibration", found, f"those of {', '.join(ids)[:200]}", store.where)
    skeleton = skeleton_by_name(run.run.skeleton)
    poses = store.query(start, end, run=run.run_id)
    first, began_ns, ended_ns = rows[0]["slot"], rows[0]["time_ns"], rows[-1]["time_ns"]
    records = slot_records(rows, poses, run.run.interval_s, first)
    began, ended = (
        datetime.fromtimestamp(time_ns / 1e9, timezone.utc) for time_ns in (began_ns, ended_ns)
    )
    recording = Recording(
        name=f"{site.file.name}, {began:%Y-%m-%d %H:%M:%S} to {ended:%H:%M:%S} UTC",
        rig=site.rig,
        fps=1 / run.run.interval_s,
        num_slots=records[-1].slot + 1,
        skeleton=skeleton,
        views=tuple(_arrived(records, index, len(skeleton)) for index in range(len(ids))),
        source=f"Stored live by the site {site.file.name}, run {run.run_id}.",
        processor=processor_of(site.file.record.path, ids, began_ns),
    )
    loop = {item.name: getattr(site.loop, item.name) for item in fields(site.loop)}
    summary = summarise(
        recording,
        ReplaySettings(**loop),
        records,
        site.plan.profiles,
        idle_mode=site.plan.idle_mode,
        battery_wh=site.plan.battery_wh,
        charged_j=charged_j(rows),
    )
    if (whole := store.saved(began_ns, ended_ns, site.active_w)) is not None:
        summary = replace(summary, savings=replace(summary.savings, whole_camera=whole))
    if smoothing.method is not None:
        records = smooth_poses(records, skeleton, run.run.interval_s, smoothing)
        summary = replace(summary, smooth=smoothing.method)
    lead = ADAPTIVE if site.file.lead == "adaptive" else None
    with filmed(recording, site.file.record.path, began_ns, ended_ns, site.file.pace) as (
        shown,
        folder,
    ):
        write_report(shown, records, summary, path, lead, folder=folder)
    return len(records)


def _arrived(records: Sequence[SlotRecord], camera: int, num_joints: int) -> ViewSeries:
    """Return the slots of which a camera's view came; what it showed is not in a store."""
    came = [record for record in records if record.arrived[camera]]
    return ViewSeries.from_views(
        [Poses2D.empty(num_joints)] * len(came),
        [record.slot for record in came],
        [record.time_s for record in came],
        num_joints,
    )
