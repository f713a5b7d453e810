"""Overlay pictures of a run: 3D skeletons on the frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.detectors.weights import Progress
from e3pose.output.report.overlay import (
    draw_poses,
    overlay_images,
    reproject,
    stack_strip,
    track_color,
    write_image,
    write_movie,
)
from e3pose.output.report.overlay.panels import BLIND_COLOR, camera_word
from e3pose.site.demo.summary import SLOWER

if TYPE_CHECKING:
    from e3pose.output.report.overlay.draw import Image
    from e3pose.pipeline import SlotRecord
    from e3pose.recording import Recording

STRIP_ROWS = 4  # pictures in the strip: the slot with most joints in each part of the run
PANEL_PX = 560  # height of a camera's picture
SKETCH_PX = 400  # of one without a picture
GAP_PX = 6
LIMB_PX = 6
AWAKE_GREY, ASLEEP_GREY = 244, 196


def draw(
    recording: Recording,
    records: Sequence[SlotRecord],
    moments_s: NDArray[np.float64],
    folder: Path,
    site: Path,
    progress: Progress,
) -> None:
    """Leave a strip of pictures and, where there are videos, a movie.

    Args:
        recording: with the rig and the videos.
        records: of its slots, from slot 0 on.
        moments_s: `(num_slots,)` which moment of the videos each slot was about.
        folder: to leave them in.
        site: whose `videos` folder has the videos.
        progress: called after every picture.
    """
    wanted = fullest(records)
    strip: list[Image] = []
    if not recording.videos:
        strip = [_sketch(recording, records[index]) for index in sorted(wanted)]
        write_image(folder / "overlay.png", stack_strip(strip))
        return

    def watched() -> Iterator[Image]:
        for index, image in enumerate(_played(recording, records, moments_s, site)):
            if index in wanted:
                strip.append(image)
            progress(index + 1, len(records))
            yield image

    write_movie(folder / "overlay.webm", watched(), recording.fps / SLOWER)
    write_image(folder / "overlay.png", stack_strip(strip))


def _played(
    recording: Recording,
    records: Sequence[SlotRecord],
    moments_s: NDArray[np.float64],
    site: Path,
) -> Iterator[Image]:
    """Yield one image per slot; the videos begin again where the moments do."""
    again = np.flatnonzero(np.diff(moments_s) < 0) + 1
    for part in np.split(np.arange(len(records)), again):
        if not len(part):
            continue
        first = int(part[0])
        start_s = float(moments_s[first]) - records[first].slot * recording.interval_s
        starts_s = dict.fromkeys(recording.rig.camera_ids, start_s)
        rows = [records[index] for index in part]
        yield from overlay_images(recording, rows, site, PANEL_PX, starts_s)


def fullest(records: Sequence[SlotRecord]) -> set[int]:
    """Return where in each of `STRIP_ROWS` equal parts of the run most joints were placed."""
    joints = np.array([(record.people.scores > 0).sum() for record in records])
    parts = np.array_split(np.arange(len(records)), STRIP_ROWS)
    return {int(part[joints[part].argmax()]) for part in parts if len(part)}


def _sketch(recording: Recording, record: SlotRecord) -> Image:
    """Draw stand-ins for frames: 2D detections in grey, 3D skeletons in colour."""
    import cv2

    colors = [track_color(int(track_id)) for track_id in record.people.track_ids]
    panels: list[Image] = []
    for index, camera in enumerate(recording.rig.cameras):
        width, height = camera.image_size
        awake = bool(record.selected[index]) and not record.blind
        image: Image = np.full((height, width, 3), AWAKE_GREY if awake else ASLEEP_GREY, np.uint8)
        view = recording.view(record.slot, index)
        if view is not None and awake:
            grey = [(170, 170, 170)] * len(view)
            image = draw_poses(image, view, recording.skeleton, grey, LIMB_PX)
        poses = reproject(record.people, camera)
        image = draw_poses(image, poses, recording.skeleton, colors, LIMB_PX)
        size = (max(1, round(width * SKETCH_PX / height)), SKETCH_PX)
        panel = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        text = f"{camera.camera_id} {camera_word(record, index)}"
        cv2.putText(panel, text, (10, 24), 0, 0.6, (40, 40, 40), 1, cv2.LINE_AA)
        if record.blind:
            cv2.rectangle(panel, (0, 0), (size[0] - 1, size[1] - 1), BLIND_COLOR, 6)
        panels += [panel, np.full((SKETCH_PX, GAP_PX, 3), 255, np.uint8)]
    return np.concatenate(panels[:-1], axis=1)
