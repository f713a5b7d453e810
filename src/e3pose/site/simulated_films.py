"""Films of a simulated scene, a stand-in for cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from e3pose.output.report.overlay import write_movie
from e3pose.recording import Recording, save_recording
from e3pose.simulate.films import frames

FOLDER = "videos"  # in the recording's


def write_films(recording: Recording, dest: Path, progress: Callable[[float], object]) -> None:
    """Write a film per camera into the folder of a simulated recording, which names them then.

    Args:
        recording: a simulated one, of people who differ in their shade.
        dest: its folder.
        progress: called with the share that is done.
    """
    names = {camera_id: f"{camera_id}.mp4" for camera_id in recording.rig.camera_ids}
    save_recording(replace(recording, videos=names), dest, overwrite=True)
    (dest / FOLDER).mkdir()
    for index, name in enumerate(names.values()):
        write_movie(dest / FOLDER / name, frames(recording, index), recording.fps)
        progress((index + 1) / len(names))
