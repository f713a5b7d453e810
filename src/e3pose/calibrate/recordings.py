"""Parts of a recording, or a recording with other intrinsics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording.record import Recording, ViewSeries


def first_seconds(recording: Recording, seconds: float) -> Recording:
    """Return the beginning of a recording, without its truth."""
    return between(recording, 0, min(recording.num_slots, max(1, round(seconds * recording.fps))))


def last_seconds(recording: Recording, seconds: float) -> Recording:
    """Return the end of a recording, without its truth."""
    first = max(0, recording.num_slots - max(1, round(seconds * recording.fps)))
    return between(recording, first, recording.num_slots)


def between(recording: Recording, first: int, end: int) -> Recording:
    """Return the slots from `first` to before `end` of a recording, without its truth."""
    views = []
    for series in recording.views:
        frames = slice(*np.searchsorted(series.slots, [first, end]).tolist())
        starts = series.starts[frames.start : frames.stop + 1]
        poses = slice(int(starts[0]), int(starts[-1]))
        views.append(
            ViewSeries(
                series.slots[frames] - first,
                series.times_s[frames] - first / recording.fps,
                starts - starts[0],
                series.keypoints_px[poses],
                series.scores[poses],
            )
        )
    return replace(
        recording,
        num_slots=end - first,
        views=tuple(views),
        truth=None,
        scored_slots=None,
        dies_at_s={},
    )


def with_lenses(rig: Rig, lenses: Rig) -> Rig:
    """Return the cameras of a rig with the intrinsics of another's cameras of the same names.

    Raises:
        InputError: for a camera without intrinsics, or of another image size.
    """
    cameras = []
    for camera in rig.cameras:
        lens = lenses.cameras[lenses.index(camera.camera_id)]
        if lens.image_size != camera.image_size:
            raise InputError(
                f"--intrinsics: camera {camera.camera_id}: image size: found "
                f"{lens.image_size[0]}x{lens.image_size[1]}, expected "
                f"{camera.image_size[0]}x{camera.image_size[1]} as in the recording"
            )
        cameras.append(replace(lens, T_world_camera=camera.T_world_camera))
    return Rig(tuple(cameras), rig.placed)


def known_lenses(rig: Rig) -> Rig:
    """Return a rig whose lenses were found, so that they are not assumed any more."""
    cameras = tuple(replace(camera, lens_assumed=False) for camera in rig.cameras)
    return Rig(cameras, rig.placed)
