"""Assign frames to slots by time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import floor
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.camera.provenance import Provenance
from e3pose.camera.source import Frame, open_video
from e3pose.detectors.base import Image
from e3pose.recording import Recording
from e3pose.recording.videos import VIDEOS

TIE = 1e-6  # slots; a frame this close to the middle between two slots is in the middle


@dataclass(frozen=True, slots=True)
class SlotGrid:
    """When the slots of a recording are.

    Attributes:
        fps: slots per second.
        start_s: the time of slot 0 on the rig's common clock.
        max_slots: how many slots there are at most, None for as many as there are frames for.
    """

    fps: float
    start_s: float = 0.0
    max_slots: int | None = None

    def position(self, time_s: float, offset_s: float) -> float:
        """Return where a frame falls on the slot axis; 2.25 is a quarter slot after slot 2.

        Args:
            time_s: seconds since the first frame of the camera's video.
            offset_s: when that first frame was taken on the common clock.
        """
        return (time_s + offset_s - self.start_s) * self.fps

    def video_time_s(self, slot: int, offset_s: float) -> float:
        """Return the time in the camera's video from which on a frame is nearest to `slot`."""
        return (slot - 0.5) / self.fps + self.start_s - offset_s

    def last_slot(self, length_s: float, offset_s: float) -> int:
        """Return the last slot that a video of `length_s` seconds has a frame for; -1 for none."""
        last = floor(self.position(length_s, offset_s) + 0.5)
        return max(-1, last if self.max_slots is None else min(last, self.max_slots - 1))


class Picture(Protocol):
    """A frame of a video, or an image of a folder."""

    @property
    def time_s(self) -> float:
        """Seconds since the first."""
        ...

    @property
    def image(self) -> NDArray[np.uint8]:
        """`(height, width, 3)` RGB."""
        ...


AnyFrame = TypeVar("AnyFrame", bound=Picture)


def frames_in_slots(
    frames: Iterable[AnyFrame], grid: SlotGrid, offset_s: float, first_slot: int = 0
) -> Iterator[tuple[int, float, AnyFrame]]:
    """Give every slot the frame nearest to its time, if one is at most half a slot away.

    Of two frames equally near, the earlier is taken. A slot without a frame is left out: the camera
    has no view then.

    Args:
        frames: in rising time.
        grid: the slots.
        offset_s: when the video's first frame was taken on the common clock.
        first_slot: slots before it are left out.

    Yields:
        Slot, capture time in seconds after slot 0, and the frame.
    """
    chosen: tuple[int, float, AnyFrame] | None = None
    for frame in frames:
        position = grid.position(frame.time_s, offset_s)
        slot = floor(position + 0.5 - TIE)
        if slot < first_slot:
            continue
        if grid.max_slots is not None and slot >= grid.max_slots:
            break
        candidate = (slot, position / grid.fps, frame)
        if chosen is None:
            chosen = candidate
        elif slot > chosen[0]:
            yield chosen
            chosen = candidate
        elif abs(position - slot) < abs(chosen[1] * grid.fps - slot) - TIE:
            chosen = candidate
    if chosen is not None:
        yield chosen


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

    def __init__(
        self,
        recording: Recording,
        camera: int,
        folder: Path | None,
        provenance: Provenance,
        first_slot: int = 0,
    ) -> None:
        """Open the video of a camera.

        Args:
            recording: that names it.
            camera: index.
            folder: of the recording, for videos that stand in it.
            provenance: which time in the video is the recording's zero, and how it was turned.
            first_slot: the first that will be asked for.
        """
        name = recording.rig.camera_ids[camera]
        grid = SlotGrid(recording.fps, provenance.video_starts_s.get(name, 0.0))
        size = recording.rig.cameras[camera].image_size
        source = open_video(video_path(recording, name, folder), size, provenance.as_stored)
        frames = source.frames(max(0.0, grid.video_time_s(first_slot, 0.0)))
        self._frames = frames_in_slots(frames, grid, 0.0, first_slot)
        self._next = next(self._frames, None)
        self._slot: int | None = None
        self._frame: Frame | None = None

    def newest(self, slot: int, most_px: int | None = None) -> Image | None:
        """Return the image of a slot, or that of the last slot before it that has one.

        Args:
            slot: the slot.
            most_px: height to which a higher image shrinks; None for the image as it is.
        """
        while self._next is not None and self._next[0] <= slot:
            self._slot, self._frame = self._next[0], self._next[2]
            self._next = next(self._frames, None)
        if self._frame is None:
            return None
        width, height = self._frame.size
        if most_px is None or height <= most_px:
            return self._frame.image
        return self._frame.shrunk((max(1, round(width * most_px / height)), most_px))

    def image(self, slot: int) -> Image | None:
        """Return the `(height, width, 3)` RGB image of a slot; None where it has none."""
        image = self.newest(slot)
        return image if self._slot == slot else None
