"""Settings of detection in videos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, get_args

from e3pose.base.errors import InputError
from e3pose.recording.record import MAX_FPS, MIN_FPS
from e3pose.settings.limits import Rotation
from e3pose.settings.loop import WHOLE_EVERY

MAX_SLOTS = 100_000_000


@dataclass(frozen=True, slots=True)
class DetectSettings:
    """Which frames to detect in, and what becomes of the videos.

    Attributes:
        fps: slots per second; None for the videos' common rate.
        every: detect in every so many slots of that rate only.
        start_s: where slot 0 lies, in seconds after the common clock's zero.
        max_slots: at most so many slots; None for all.
        rotations: for each camera, by how many degrees clockwise its images are turned for the
            detector, so that people are upright; 0 if not given.
        offsets_s: for each camera, when its video's first frame was taken on the common clock, in
            seconds; 0 if not given.
        keep_videos: `refer` to the videos where they are, `link` or `copy` them into the recording.
        overwrite: replace a recording at the destination, and unfinished work of other settings.
        feedback: detect in the parts of images in which people are expected, by what all cameras
            found before; needs cameras whose places are known.
        whole_every: with feedback, one of so many detections uses the full frame.
    """

    fps: float | None = None
    every: int = 1
    start_s: float = 0.0
    max_slots: int | None = None
    rotations: Mapping[str, int] = field(default_factory=dict)
    offsets_s: Mapping[str, float] = field(default_factory=dict)
    keep_videos: Literal["refer", "link", "copy"] = "refer"
    overwrite: bool = False
    feedback: bool = False
    whole_every: int = WHOLE_EVERY

    def __post_init__(self) -> None:
        if self.fps is not None and not MIN_FPS <= self.fps <= MAX_FPS:
            raise InputError(
                f"fps: found {self.fps}, expected a rate from {MIN_FPS:g} to {MAX_FPS:g}"
            )
        if not 1 <= self.every <= 100_000:
            raise InputError(f"every: found {self.every}, expected 1 to 100000")
        if not (isfinite(self.start_s) and 0 <= self.start_s <= 1e7):
            raise InputError(f"start: found {self.start_s}, expected seconds, 0 or more")
        if self.max_slots is not None and not 1 <= self.max_slots <= MAX_SLOTS:
            raise InputError(f"max slots: found {self.max_slots}, expected 1 to {MAX_SLOTS}")
        for camera_id, degrees in self.rotations.items():
            if degrees not in get_args(Rotation):
                wanted = "0, 90, 180 or 270 degrees"
                raise InputError(f"camera {camera_id}: rotation", str(degrees), wanted)
        for camera_id, offset_s in self.offsets_s.items():
            if not abs(offset_s) <= 1e7:
                raise InputError(f"camera {camera_id}: offset: found {offset_s}, expected seconds")
