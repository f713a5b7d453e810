"""The report of a time range of a live store, with the site's recorded videos and times.

`slot_records` reads slots of a store back as slot records.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from datetime import datetime, timezone
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.camera.provenance import load_provenance, save_provenance
from e3pose.camera.session_videos import BEGAN, PACE
from e3pose.estimate.smooth import SmoothSettings
from e3pose.evaluate.smoothed import smooth_poses
from e3pose.evaluate.summary import summarise
from e3pose.model.blind_slot import blind_cause
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report.page import write_report
from e3pose.recording import ProcessorTime, Recording, ViewSeries
from e3pose.recording.folder import HEADER, MAX_HEADER_BYTES
from e3pose.recording.processor import load_processor
from e3pose.recording.videos import VIDEOS, begin_of, choose_video, videos_in
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.resolved import ResolvedSite
from e3pose.store import Store
from e3pose.store.answers import StoredPoses
from e3pose.store.query import Time

AS_STORED = SmoothSettings()
ADAPTIVE = "adaptive: follows the delays"
MOST_SLOTS = 200_000  # of a page: two hours at 25 slots per second
MOST = 1000  # recordings that are looked through, the newest


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
    skeleton = site.skeleton
    if skeleton.joints != run.run.joints:
        skeleton = run.run.limbed
    poses = store.query(start, end, run=run.run_id)
    first, began_ns, ended_ns = rows[0]["slot"], rows[0]["time_ns"], rows[-1]["time_ns"]
    records: Sequence[SlotRecord] = slot_records(rows, poses, run.run.interval_s, first)
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
    """Return the slots in which a camera's view came; a store does not keep its content."""
    came = [record for record in records if record.arrived[camera]]
    return ViewSeries.from_views(
        [Poses2D.empty(num_joints)] * len(came),
        [record.slot for record in came],
        [record.time_s for record in came],
        num_joints,
    )


@contextmanager
def filmed(
    recording: Recording, folder: Path, began_ns: int, ended_ns: int, pace: float
) -> Iterator[tuple[Recording, Path | None]]:
    """Yield a recording with the videos of its time, and the folder that says where they begin.

    Args:
        recording: of a stretch, slot 0 at its beginning.
        folder: of the site's recordings and videos.
        began_ns: time of slot 0, since 1970.
        ended_ns: of the last slot.
        pace: seconds of the scene that passed in a second.
    """
    found = videos_of(folder, recording.rig.camera_ids, began_ns, ended_ns)
    if not found:
        yield recording, None
        return
    with TemporaryDirectory() as made:
        starts_s = {name: (began_ns - begin) / 1e9 * pace for name, (begin, _) in found.items()}
        save_provenance(Path(made), {}, starts_s)
        videos = {name: str(path.resolve()) for name, (_, path) in found.items()}
        yield replace(recording, videos=videos), Path(made)


def videos_of(
    folder: Path, camera_ids: tuple[str, ...], began_ns: int, ended_ns: int
) -> dict[str, tuple[int, Path]]:
    """Return by camera when its video of a stretch of time begins, since 1970, and where it is.

    Of several, the one that is in a recording, else the one that shows most of the stretch.
    """
    found: dict[str, tuple[int, Path]] = {}
    for part, zero_ns, header in _kept(folder, began_ns):
        with suppress(InputError, KeyError, ValueError, TypeError):
            starts_s, pace = load_provenance(part).video_starts_s, _pace(part)
            for name, file in header.get(VIDEOS, {}).items():
                if name in camera_ids:
                    begin_ns = zero_ns - round(starts_s[name] / pace * 1e9)
                    found.setdefault(name, (begin_ns, part / VIDEOS / file))
    for name in camera_ids:
        video = choose_video(videos_in(folder / VIDEOS / name), began_ns, ended_ns)
        if name not in found and video is not None:
            found[name] = begin_of(video) or 0, video
    return found


def processor_of(
    folder: Path, camera_ids: tuple[str, ...], began_ns: int
) -> Mapping[str, ProcessorTime]:
    """Return the processor time of cameras, by the newest recording that has it; empty without."""
    for part, _, _ in _kept(folder, began_ns):
        with suppress(InputError):
            if found := load_processor(part, camera_ids):
                return found
    return {}


def _kept(folder: Path, time_ns: int) -> Iterator[tuple[Path, int, dict[str, Any]]]:
    """Yield the recordings of a time, newest first, with when they begin and their headers."""
    for path in sorted(folder.glob(f"*/{HEADER}"), reverse=True)[:MOST]:
        with suppress(InputError, KeyError, ValueError, TypeError, ZeroDivisionError):
            header = read_toml(path, MAX_HEADER_BYTES)
            zero_ns = int(load_provenance(path.parent).settings[BEGAN])
            end_ns = zero_ns + round(header["num_slots"] / header["fps"] / _pace(path.parent) * 1e9)
            if zero_ns <= time_ns <= end_ns:
                yield path.parent, zero_ns, header


def _pace(part: Path) -> float:
    return float(load_provenance(part).settings[PACE])


def slot_records(
    rows: Sequence[Mapping[str, Any]],
    poses: StoredPoses,
    interval_s: float,
    first_slot: int = 0,
) -> list[SlotRecord]:
    """Return one record per row.

    Args:
        rows: of the table `slots` of one run, as `Store.rows` gives them.
        poses: of the same run and time.
        interval_s: seconds per slot.
        first_slot: the slot that becomes 0.
    """
    return [_record(row, poses, interval_s, first_slot) for row in rows]


def charged_j(rows: Sequence[Mapping[str, Any]]) -> Floats | None:
    """Return `(num_slots, num_cameras)` joules that slots are charged with; None where unknown.

    Args:
        rows: as of `slot_records`.
    """
    known = [row["energy_j"] for row in rows]
    return None if None in known or not known else np.array(known, dtype=np.float64)


def _record(
    row: Mapping[str, Any], poses: StoredPoses, interval_s: float, first_slot: int
) -> SlotRecord:
    low, high = np.searchsorted(poses.slots, [row["slot"], row["slot"] + 1])
    here, slot = slice(low, high), row["slot"] - first_slot
    people = poses.people[here]
    doubles = {
        name: getattr(people, name).astype(np.float64) for name in ("joints_m", "scores", "sigma_m")
    }
    return SlotRecord(
        slot=slot,
        time_s=slot * interval_s,
        selected=_flags(row["selected"]),
        arrived=_flags(row["arrived"]),
        people=replace(people, **doubles),
        occlusion=np.asarray(row["occlusion"], dtype=np.float64),
        deficit=np.asarray(row["deficit"], dtype=np.float64),
        next_selection=_flags(row["next_selection"]),
        stage_s={"step": row["took_s"]},
        blind=_blind(row),
    )


def _blind(row: Mapping[str, Any]) -> str:
    """Return the cause of a blind slot, inferred for records of older versions."""
    if row["blind"] is not None:
        return str(row["blind"])
    selected, arrived = _flags(row["selected"]), _flags(row["arrived"])
    return blind_cause(selected, np.ones_like(selected), bool(arrived.any()))


def _flags(text: str) -> NDArray[np.bool_]:
    return np.array([char == "1" for char in text])
