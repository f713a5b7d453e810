"""Read a live run back from its store as slot records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.pose import Poses2D
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.site.demo.live import Heard
from e3pose.store import Store
from e3pose.store.records import charged_j, slot_records


@dataclass(frozen=True, slots=True)
class Film:
    """The clip that the cameras of a site play in a loop.

    Attributes:
        length_s: of one round, seconds of the scene.
        pace: seconds of the scene that pass in a second.
        begin_ns: when it began, since 1970.
    """

    length_s: float
    pace: float
    begin_ns: int = 0

    def at_s(self, time_ns: int) -> float:
        """Return the scene's time that is shown at a time since 1970."""
        round_ns = round(self.length_s / self.pace * 1e9)
        return (time_ns - self.begin_ns) % round_ns / 1e9 * self.pace

    def moments(self, heard: Heard, records: Sequence[SlotRecord], times: Sequence[int]) -> Floats:
        """Return `(num_slots,)` seconds: which moment of the scene each slot was about.

        That is when the frames of its active cameras were taken; the middle of the slot without
        any.
        """
        taken = {slot: view.captured_ns for (slot, _), view in heard.views.items()}
        pairs = zip(records, times, strict=True)
        return np.array([self.at_s(taken.get(r.slot, time_ns)) for r, time_ns in pairs])


def stored_records(
    store: Path, interval_s: float, film: Film, num_slots: int
) -> tuple[list[SlotRecord], list[int], Floats | None]:
    """Return the records of the newest run in a store, when each slot was, and its joules.

    Times are since 1970; joules are those of `store.records.charged_j`.

    Args:
        store: the database.
        interval_s: seconds of the scene that a slot lasts.
        film: what was played.
        num_slots: how many were wanted; those after them are left out, and those after the first
            round of the film if it gave half of them.
    """
    asked = Store(store)
    run = asked.runs()[-1].run_id
    found = asked.query(run=run)
    end_ns = film.begin_ns + round((film.length_s - interval_s / 2) / film.pace * 1e9)
    rows = [row for row in asked.rows("slots", run=run) if row["slot"] < num_slots]
    first_round = [row for row in rows if row["time_ns"] < end_ns]
    rows = first_round if len(first_round) >= num_slots // 2 else rows
    times = [row["time_ns"] for row in rows]
    return slot_records(rows, found, interval_s), times, charged_j(rows)


def heard_views(
    heard: Heard, cameras: Sequence[str], num_slots: int, fps: float, num_joints: int
) -> tuple[ViewSeries, ...]:
    """Return the views of all cameras as those of a recording that begins at slot 0."""
    series = []
    for camera_id in cameras:
        slots = sorted(s for s, who in heard.views if who == camera_id and s < num_slots)
        views: list[Poses2D] = [heard.views[slot, camera_id].poses for slot in slots]
        series.append(ViewSeries.from_views(views, slots, [s / fps for s in slots], num_joints))
    return tuple(series)


def truth_at(truth: Truth, moments_s: Floats, fps: float) -> Truth:
    """Return the truth of the moments that were shown, one a slot."""
    frames = np.round(moments_s * fps).astype(np.int64) % len(truth.joints_m)
    return Truth(truth.skeleton, truth.person_ids, truth.joints_m[frames])


def as_recording(scene: Recording, heard: Heard, moments_s: Floats) -> Recording:
    """Return a live run as a recording, with the truth if there is one.

    Args:
        scene: what was shown.
        heard: what the cameras sent of it.
        moments_s: `(num_slots,)` which moment of the scene each slot was about.
    """
    count, joints = len(moments_s), len(scene.skeleton)
    return replace(
        scene,
        num_slots=count,
        views=heard_views(heard, scene.rig.camera_ids, count, scene.fps, joints),
        truth=None if scene.truth is None else truth_at(scene.truth, moments_s, scene.fps),
        scored_slots=None,
    )
