"""`e3pose attach`: put the videos of live cameras into the recording of their session."""

from __future__ import annotations

from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.camera.session_videos import attach_videos
from e3pose.recording import load_recording


def attach(recording: Path, folder: Path, /) -> None:
    """Add a live session's videos to its recording.

    Example: `e3pose attach recordings/20261122T150000Z collected`

    For cameras on other machines; the edge does it for cameras on its own.

    Parameters
    ----------
    recording
        Recording of a live site.
    folder
        Folder with one folder of videos per camera, copied from the cameras.
    """
    loaded = load_recording(recording)
    found = attach_videos(recording, folder, loaded.rig.camera_ids)
    missing = [name for name in loaded.rig.camera_ids if name not in (*found, *loaded.videos)]
    if not found:
        raise InputError(
            str(folder), "no video of the session", "CAMERA/CAMERA-TIME.mkv of its time"
        )
    print(f"{recording}: videos of {', '.join(found)}")
    if missing:
        print(f"  no video of {', '.join(missing)}")
