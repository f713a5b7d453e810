"""One image per slot: the cameras side by side with reprojected 3D skeletons."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from e3pose.base.errors import InputError
from e3pose.camera.provenance import Provenance
from e3pose.camera.slots import SlotReader
from e3pose.model.blind_slot import WORDS
from e3pose.model.camera import Camera
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report.figures import BLIND
from e3pose.output.report.overlay.draw import Image, draw_poses, reproject, track_color
from e3pose.recording import Recording

ASLEEP_BRIGHTNESS = 0.45
BORDER_PX = 4
GAP_PX = 4
AWAKE_COLOR = (80, 220, 100)
BLIND_COLOR = tuple(bytes.fromhex(BLIND.removeprefix("#")))
DRAWN = 2  # times as large as it is shown: so large a picture is drawn on
LABEL_HEIGHT = 0.035  # of the panel
CAPITAL_PX = 22  # height of OpenCV's capitals at size 1


def overlay_images(
    recording: Recording,
    records: Iterable[SlotRecord],
    folder: Path | None = None,
    height_px: int = 480,
    provenance: Provenance = Provenance(),  # noqa: B008 - frozen
    cameras: Sequence[str] | None = None,
) -> Iterator[Image]:
    """Yield one image per slot: a panel per camera, left to right.

    An awake camera has a green frame; one that sleeps is dark, and its frame was not used. In a
    blind slot all are dark with an amber frame. The skeletons are the slot's 3D poses, drawn where
    each camera sees them.

    Args:
        recording: with videos.
        records: in rising slots.
        folder: the recording's, for videos that stand in it.
        height_px: of the image.
        provenance: which time in each video is the recording's zero, 0 if not given, and how its
            images were turned.
        cameras: which to show; all that have a video by default.

    Raises:
        InputError: when a video is missing, or there is none.
    """
    chosen = [name for name in recording.rig.camera_ids if name in (cameras or recording.videos)]
    if not chosen or any(name not in recording.videos for name in chosen):
        raise InputError(f"recording {recording.name}: no videos of {chosen or 'any camera'}")
    readers: dict[str, SlotReader] = {}
    for record in records:
        panels = []
        for name in chosen:
            index = recording.rig.index(name)
            if name not in readers:
                readers[name] = SlotReader(recording, index, folder, provenance, record.slot)
            camera = recording.rig.cameras[index]
            image = readers[name].newest(record.slot, DRAWN * height_px)
            if image is None:
                width, height = camera.image_size
                image = np.zeros((height, width, 3), dtype=np.uint8)
            panels.append(_panel(image, record, camera, recording, index, height_px))
        yield _side_by_side(panels)


def camera_word(record: SlotRecord, camera: int) -> str:
    """Return what a camera, by its index, did in a slot: `active`, `idle` or why it is blind."""
    if record.blind:
        return f"blind: {WORDS.get(record.blind, record.blind)}"
    return "active" if record.selected[camera] else "idle"


def _panel(
    image: Image,
    record: SlotRecord,
    camera: Camera,
    recording: Recording,
    index: int,
    height_px: int,
) -> Image:
    import cv2

    scale = height_px / image.shape[0]
    width_px = max(1, round(image.shape[1] * scale))
    awake = bool(record.selected[index]) and not record.blind
    if not awake:
        image = (image * ASLEEP_BRIGHTNESS).astype(np.uint8)
    # Lines are drawn larger and shrink with the picture.
    colors = [track_color(int(track_id)) for track_id in record.people.track_ids]
    poses = reproject(record.people, camera)
    places_px = (poses.keypoints_px + 0.5) * (image.shape[0] / camera.image_size[1]) - 0.5
    poses = Poses2D(places_px, poses.scores)
    drawn = draw_poses(image, poses, recording.skeleton, colors)
    panel = cv2.resize(drawn, (width_px, height_px), interpolation=cv2.INTER_AREA)
    text = f"{camera.camera_id} {camera_word(record, index)}"
    size = LABEL_HEIGHT * height_px / CAPITAL_PX
    height = round(LABEL_HEIGHT * height_px)
    band = panel[BORDER_PX : 6 * BORDER_PX + height]
    band[:] = band // 2  # so that the label is read on any picture
    place = (4 * BORDER_PX, 3 * BORDER_PX + height)
    cv2.putText(panel, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255))
    if awake or record.blind:
        corner, color = (width_px - 1, height_px - 1), AWAKE_COLOR if awake else BLIND_COLOR
        cv2.rectangle(panel, (0, 0), corner, color, 2 * BORDER_PX)
    return np.asarray(panel, dtype=np.uint8)


def _side_by_side(panels: Sequence[Image]) -> Image:
    gap = np.full((panels[0].shape[0], GAP_PX, 3), 255, dtype=np.uint8)
    parts: list[Image] = []
    for panel in panels:
        parts += [panel, gap]
    return np.concatenate(parts[:-1], axis=1)
