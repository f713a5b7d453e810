"""Fault injection into a replay: camera failures, lost views, a lower frame rate. Pure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
from e3pose.recording import Recording, ViewSeries
from e3pose.recording.record import MIN_FPS
from e3pose.settings.faults import EACH, Kill

KILL = re.compile(r"(?P<camera>.+)@(?P<when>\d{1,9}(?:\.\d{1,9})?)(?P<unit>s?)")
LOSS_STREAM = 7  # sets the draws of losses apart from those of policies with the same seed


def parse_kill(text: str) -> Kill:
    """Read `CAMERA@SLOT` or `CAMERA@SECONDSs`; raise `InputError` for anything else."""
    match = KILL.fullmatch(text.strip())
    if match is None or ("." in match["when"] and not match["unit"]):
        raise InputError(
            f"--kill-camera: found {text[:80]!r}, expected CAMERA@SLOT or CAMERA@SECONDSs, "
            "such as cam2@100 or cam2@12.5s"
        )
    if match["unit"]:
        return Kill(match["camera"], time_s=float(match["when"]))
    return Kill(match["camera"], slot=int(match["when"]))


def deaths_s(recording: Recording, kills: Sequence[Kill], phase: int = 0) -> Floats:
    """Return `(num_cameras,)` seconds from which on each camera is gone; inf for never.

    Args:
        recording: whose own deaths count, too.
        kills: further deaths.
        phase: which camera of the rig `each` means.

    Raises:
        InputError: when there is no such camera.
    """
    ids = recording.rig.camera_ids
    deaths = np.array([recording.dies_at_s.get(camera_id, np.inf) for camera_id in ids])
    for kill in kills:
        if kill.camera_id not in (*ids, EACH):
            raise InputError(
                f"--kill-camera: found {kill.camera_id[:64]!r}, expected one of {', '.join(ids)}, "
                f"or {EACH}"
            )
        index = phase % len(ids) if kill.camera_id == EACH else ids.index(kill.camera_id)
        time_s = kill.time_s if kill.slot is None else kill.slot * recording.interval_s
        deaths[index] = min(deaths[index], time_s)
    return deaths


def arriving(num_cameras: int, loss: float, seed: int, slot: int) -> Flags:
    """Return `(num_cameras,)`: whose view of `slot` arrives, if it is sent.

    The draws depend on seed, slot and camera alone: policies that are compared lose the same views.

    Raises:
        InputError: when `loss` is no share.
    """
    if not 0 <= loss <= 1:
        raise InputError(f"--loss: found {loss:g}, expected a share of views from 0 to 1")
    if loss == 0:
        return np.ones(num_cameras, dtype=bool)
    return np.asarray(np.random.default_rng([LOSS_STREAM, seed, slot]).random(num_cameras) >= loss)


def capacity_j(recording: Recording) -> Floats:
    """Return `(num_cameras,)` joules in each battery at the start; inf where there is no limit."""
    ids = recording.rig.camera_ids
    return np.array([3600 * recording.battery_wh.get(i, np.inf) for i in ids])


def downsampled(recording: Recording, fps: float) -> Recording:
    """Return the recording at fewer frames per second.

    Every new slot takes the views and truth of the nearest slot there is. Capture times stay as
    they were, hence irregular where `fps` is no whole part of the recording's.

    Raises:
        InputError: when `fps` is above the recording's, or that of no recording.
    """
    if not MIN_FPS <= fps <= recording.fps:
        raise InputError(
            f"--fps: found {fps:g}, expected {MIN_FPS:g} at least and at most the recording's "
            f"{recording.fps:g}"
        )
    if fps == recording.fps:
        return recording
    count = int(np.floor((recording.num_slots - 1) * fps / recording.fps + 1e-9)) + 1
    kept = np.rint(np.arange(count if recording.num_slots else 0) * recording.fps / fps)
    kept = np.minimum(kept, recording.num_slots - 1).astype(np.int64)
    truth = recording.truth
    if truth is not None:
        truth = replace(truth, joints_m=truth.joints_m[kept])
    scored = recording.scored_slots
    if scored is not None:
        first, stop = np.searchsorted(kept, scored).tolist()
        scored = (first, stop)
    return replace(
        recording,
        name=f"{recording.name[:150]}, {fps:g} fps",
        fps=float(fps),
        num_slots=len(kept),
        views=tuple(_downsampled_series(series, kept) for series in recording.views),
        truth=truth,
        scored_slots=scored,
    )


def _downsampled_series(series: ViewSeries, kept: NDArray[np.int64]) -> ViewSeries:
    """Keep the views of the slots `kept`, which become slots 0, 1, 2 and so on."""
    frames = np.searchsorted(series.slots, kept)
    there = frames < len(series.slots)
    there[there] = series.slots[frames[there]] == kept[there]
    frames = frames[there]
    counts = np.diff(series.starts)[frames]
    people = np.concatenate(
        [np.arange(series.starts[f], series.starts[f + 1]) for f in frames]
        or [np.zeros(0, dtype=np.int64)]
    ).astype(np.int64)
    return ViewSeries(
        np.flatnonzero(there).astype(np.int64),
        series.times_s[frames],
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        series.keypoints_px[people],
        series.scores[people],
    )
