"""Images of a recording's videos in the order of slots."""

from __future__ import annotations

from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.camera.slots import SlotGrid, frames_in_slots
from e3pose.camera.source import Frame, open_video
from e3pose.detectors.base import Image
from e3pose.recording import Recording
from e3pose.recording.videos import VIDEOS


def video_path(recording: Recording, camera_id: str, folder: Path | None) -> Path:
    """Return where the video of a camera is.

    Args:
        recording: that names it.
        camera_id: of a camera with a video.
        folder: of the recording, for videos that stand in it.

    Raises:
        InputError: when it is in the recording, whose folder is not given.
    """
    path = Path(recording.videos[camera_id])
    if path.is_absolute():
        return path
    if folder is None or path.name != str(path):
        raise InputError(
            f"recording {recording.name}: videos: {camera_id}: found {str(path)[:80]!r}, expected "
            "an absolute path or the name of a file in the recording's videos folder"
        )
    return folder / VIDEOS / path


class SlotReader:
    """Hands out a video's images; slots must not fall."""

    def __init__(self, path: Path, fps: float, start_s: float, first_slot: int) -> None:
        """Open a video.

        Args:
            path: of the video.
            fps: slots per second.
            start_s: which time in the video is the recording's zero.
            first_slot: the first that will be asked for.
        """
        grid = SlotGrid(fps, start_s)
        source = open_video(path)
        frames = source.frames(max(0.0, grid.video_time_s(first_slot, 0.0)))
        self._frames = frames_in_slots(frames, grid, 0.0, first_slot)
        self._next = next(self._frames, None)
        self._slot: int | None = None
        self._frame: Frame | None = None

    def newest(self, slot: int) -> Image | None:
        """Return the image of a slot, or that of the last slot before it that has one."""
        while self._next is not None and self._next[0] <= slot:
            self._slot, self._frame = self._next[0], self._next[2]
            self._next = next(self._frames, None)
        return None if self._frame is None else self._frame.image

    def image(self, slot: int) -> Image | None:
        """Return the `(height, width, 3)` RGB image of a slot; None where it has none."""
        image = self.newest(slot)
        return image if self._slot == slot else None
