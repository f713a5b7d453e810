"""Skeletons drawn over video frames: images, one per slot with all cameras, and movies of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.camera.provenance import Provenance
from e3pose.camera.slots import SlotReader
from e3pose.model.blind_slot import WORDS
from e3pose.model.camera import Camera
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report.figures import BLIND
from e3pose.recording import Recording

Image = NDArray[np.uint8]
Color = tuple[int, int, int]

# Distinct with any colour vision (after Okabe and Ito), bright enough for dim pictures, and in
# the order of the report's, so that a person has much the same colour in both.
TRACK_COLORS: tuple[Color, ...] = (
    (60, 150, 255), (255, 115, 25), (0, 225, 150), (255, 140, 205),
    (130, 220, 255), (255, 205, 40), (215, 215, 215), (190, 120, 70),
)  # fmt: skip
SUBPIXEL_BITS = 4  # OpenCV draws lines between sixteenths of a pixel
MAX_DRAWN_PX = 20_000  # beyond, OpenCV's fixed-point coordinates overflow
OUTLINE: Color = (0, 0, 0)


def track_color(track_id: int) -> Color:
    """Return the RGB colour of a track: always the same, and unlike those of its neighbours."""
    return TRACK_COLORS[track_id % len(TRACK_COLORS)]


def draw_poses(
    image: Image,
    poses: Poses2D,
    skeleton: Skeleton,
    colors: Sequence[Color],
    thickness_px: int | None = None,
) -> Image:
    """Return the image with skeletons drawn on it.

    Args:
        image: `(height, width, 3)` RGB; stays as it is.
        poses: pixels of that image; what is missing is not drawn.
        skeleton: the convention of the poses.
        colors: RGB, one per person.
        thickness_px: of a limb; by default it follows the image's height.
    """
    import cv2

    drawn: Image = image.copy()
    width = thickness_px or max(1, round(image.shape[0] / 240))
    scale = 1 << SUBPIXEL_BITS
    for joints_px, color in zip(poses.keypoints_px, colors, strict=True):
        with np.errstate(invalid="ignore"):
            seen = (np.abs(joints_px) < MAX_DRAWN_PX).all(axis=-1)
        ends = np.where(seen[:, None], joints_px * scale, 0).round().astype(np.int64).tolist()
        limbs = [(a, b) for a, b in skeleton.limbs if seen[a] and seen[b]]
        # The dark outline first, so that a skeleton stands out from clothes of its colour.
        for paint, extra in ((OUTLINE, 2), (color, 0)):
            for a, b in limbs:
                cv2.line(drawn, ends[a], ends[b], paint, width + extra, cv2.LINE_AA, SUBPIXEL_BITS)
            for joint in np.flatnonzero(seen):
                radius = (width + 1 + extra // 2) * scale
                cv2.circle(drawn, ends[joint], radius, paint, -1, cv2.LINE_AA, SUBPIXEL_BITS)
    return drawn


def reproject(people: People, camera: Camera) -> Poses2D:
    """Return where a camera sees people; joints behind it are missing."""
    if not len(people):
        return Poses2D.empty(people.scores.shape[1])
    return Poses2D(camera.project(people.joints_m), people.scores)


# VP9 plays in every browser, and its encoder is BSD-licensed; that of H.264 in PyAV is GPL.
CODECS: dict[str, dict[str, str]] = {
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "8", "row-mt": "1", "crf": "30", "b": "0"},
    "mpeg4": {"qscale": "4"},
}
SUFFIXES = (".webm", ".mp4", ".mkv")


def write_movie(path: Path, images: Iterable[Image], fps: float) -> int:
    """Write RGB images as a movie, whole or not at all, and return how many there were.

    Args:
        path: `.webm`, `.mp4` or `.mkv`.
        images: `(height, width, 3)`, all of one size; an odd last row or column is cut off.
        fps: images per second.

    Raises:
        InputError: when there is no image, sizes differ, or the suffix is another.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(SUFFIXES)}")
    if not 0 < fps <= 1000:
        raise InputError(f"{path}: fps: found {fps}, expected a rate in (0, 1000]")
    iterator = iter(images)
    first = next(iterator, None)
    if first is None:
        raise InputError(f"{path}: found no image to write, expected at least one")
    height, width = (side - side % 2 for side in first.shape[:2])
    count = 0
    with atomic_file(path) as temporary, _encoder(temporary, width, height, fps) as encode:
        for image in chain([first], iterator):
            if image.shape != first.shape:
                raise InputError(
                    f"{path}: image {count}: found shape {image.shape}, expected {first.shape}"
                )
            encode(np.ascontiguousarray(image[:height, :width]))
            count += 1
    return count


@contextmanager
def _encoder(path: Path, width: int, height: int, fps: float) -> Iterator[Any]:
    import av

    rate = Fraction(fps).limit_denominator(1001)
    codec = next(name for name in CODECS if name in av.codecs_available)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=CODECS[codec])
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        yield lambda image: container.mux(
            stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24"))
        )
        container.mux(stream.encode())


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
        gap = np.full((panels[0].shape[0], GAP_PX, 3), 255, dtype=np.uint8)
        beside = [part for panel in panels for part in (panel, gap)]
        yield np.concatenate(beside[:-1], axis=1)


def camera_word(record: SlotRecord, camera: int) -> str:
    """Return a camera's state in a slot: `active`, `idle` or why it is blind."""
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
    larger = np.divide(image.shape[1::-1], camera.image_size)
    poses = reproject(record.people, camera).resized(larger)
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
