"""Attach videos of live cameras to the recording of their session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.camera.provenance import load_provenance, save_provenance
from e3pose.recording.folder import HEADER, MAX_HEADER_BYTES
from e3pose.recording.videos import begin_of, choose_video, take_videos, videos_in

BEGAN, PACE = "began", "pace"  # of a session's recording, in its `detection.toml`


def note_session(
    recording: Path, began_ns: int, pace: float, rotations: Mapping[str, int] | None = None
) -> None:
    """Save the time of slot 0 of a recording, so that videos can be attached later.

    Args:
        recording: its folder.
        began_ns: the middle of slot 0, since 1970.
        pace: seconds of the scene that passed in a second.
        rotations: by camera, degrees clockwise by which its images were turned for its detector.
    """
    save_provenance(recording, {BEGAN: str(began_ns), PACE: f"{pace:g}"}, {}, rotations)


def attach_videos(recording: Path, folder: Path, camera_ids: Sequence[str]) -> list[str]:
    """Move the videos of a session into its recording; return the cameras that got theirs.

    Args:
        recording: a folder that `note_session` noted, at the site or moved since.
        folder: has a folder of videos for each camera.
        camera_ids: whose videos are wanted; those with a video already stay as they are.

    Raises:
        InputError: for a recording that does not say when it began.
        OSError: when the videos cannot be moved.
    """
    noted = load_provenance(recording)
    header = read_toml(recording / HEADER, MAX_HEADER_BYTES)
    try:
        began_ns, pace = int(noted.settings[BEGAN]), float(noted.settings[PACE])
        length_ns = round(header["num_slots"] / header["fps"] / pace * 1e9)
        there = header.get("videos", {})
    except (KeyError, ValueError, TypeError, ZeroDivisionError):
        raise InputError(
            str(recording), "a recording that does not say when it began", "one of a live site"
        ) from None
    found: dict[str, Path] = {}
    starts_s = dict(noted.video_starts_s)
    for camera_id in camera_ids:
        video = choose_video(videos_in(folder / camera_id), began_ns, began_ns + length_ns)
        if video is None or camera_id in there:
            continue
        found[camera_id] = video
        starts_s[camera_id] = (began_ns - (begin_of(video) or 0)) / 1e9 * pace
    save_provenance(recording, noted.settings, starts_s, noted.rotations)
    take_videos(recording, found)
    return list(found)
