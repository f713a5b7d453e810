"""Pictures of a run: the 3D skeletons on the frames, or on blank ones where nothing was filmed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from e3pose.demo.words import SLOWER
from e3pose.weights import Progress

if TYPE_CHECKING:
    from e3pose.overlay.draw import Image
    from e3pose.pipeline import SlotRecord
    from e3pose.recording import Recording

STRIP_ROWS = 4  # pictures in the strip: the slot with most joints in each part of the run
PANEL_PX = 560  # height of a camera's picture


def draw(
    recording: Recording, records: Sequence[SlotRecord], folder: Path, progress: Progress
) -> None:
    """Leave a strip of pictures and, where there are videos, a movie."""
    from e3pose.overlay import overlay_images, stack_strip, write_image, write_movie

    wanted = _fullest(records)
    strip: list[Image] = []
    if not recording.videos:
        strip = [_sketch(recording, records[index]) for index in sorted(wanted)]
        write_image(folder / "overlay.png", stack_strip(strip))
        return

    def watched() -> Iterator[Image]:
        images = overlay_images(recording, records, folder / "recording", PANEL_PX)
        for index, image in enumerate(images):
            if index in wanted:
                strip.append(image)
            progress(index + 1, len(records))
            yield image

    write_movie(folder / "overlay.webm", watched(), recording.fps / SLOWER)
    write_image(folder / "overlay.png", stack_strip(strip))


def _fullest(records: Sequence[SlotRecord]) -> set[int]:
    """Return where in each of `STRIP_ROWS` equal parts of the run most joints were placed."""
    joints = np.array([(record.poses.scores > 0).sum() for record in records])
    parts = np.array_split(np.arange(len(records)), STRIP_ROWS)
    return {int(part[joints[part].argmax()]) for part in parts if len(part)}


def _sketch(recording: Recording, record: SlotRecord) -> Image:
    """Draw what stands in for a frame: 2D detections in grey, 3D skeletons over them in colour."""
    from e3pose.overlay import draw_poses, reproject, track_color

    panels = []
    for index, camera in enumerate(recording.rig.cameras):
        width, height = camera.image_size
        awake = bool(record.selected[index])
        image = np.full((height, width, 3), 250 if awake else 120, dtype=np.uint8)
        view = recording.view(record.slot, index)
        if view is not None and awake:
            image = draw_poses(image, view, recording.skeleton, [(190, 190, 190)] * len(view))
        colors = [track_color(int(track_id)) for track_id in record.track_ids]
        poses = reproject(record.poses, camera)
        panels.append(draw_poses(image, poses, recording.skeleton, colors)[::2, ::2])
    lowest = min(panel.shape[0] for panel in panels)
    return np.concatenate([panel[:lowest] for panel in panels], axis=1)
