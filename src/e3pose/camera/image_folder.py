"""Read a folder of numbered images like a video."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.camera.source import MAX_PIXELS, VideoSource, open_video
from e3pose.recording.detections.openpose import frame_number

KINDS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True, slots=True)
class ImageFrame:
    """One image.

    Attributes:
        index: how many the reader gave before.
        time_s: seconds since the lowest number of all cameras.
        path: the file.
        image_size: `(width, height)` that it must have.
    """

    index: int
    time_s: float
    path: Path
    image_size: tuple[int, int]

    @property
    def image(self) -> NDArray[np.uint8]:
        """`(height, width, 3)` RGB, read at every call."""
        image = _read(self.path)
        size = image.shape[1], image.shape[0]
        if size != self.image_size:
            raise InputError(
                f"{self.path}: image size: found {size[0]}x{size[1]}, expected "
                f"{self.image_size[0]}x{self.image_size[1]} as the first image"
            )
        return image


@dataclass(frozen=True, slots=True)
class ImageFolder:
    """A folder of images whose names end in their number.

    Attributes:
        path: the folder.
        rate: images per second.
        image_size: `(width, height)` of the first.
        files: number to file, in rising order.
        first: the number at time 0.
        turned: False: images are read as they are stored.
        damage: empty: what cannot be read stops the reading.
    """

    path: Path
    rate: float
    image_size: tuple[int, int]
    files: Mapping[int, Path]
    first: int
    turned: bool = field(default=False, init=False)
    damage: str = field(default="", init=False)

    @property
    def num_frames(self) -> int:
        """How many images there would be if no number were missing."""
        return max(self.files) - self.first + 1

    def frames(self, start_s: float = 0.0) -> Iterator[ImageFrame]:
        """Yield the images from `start_s` on, in rising time; a number that lacks is a gap."""
        for index, (number, path) in enumerate(self.files.items()):
            time_s = (number - self.first) / self.rate
            if time_s >= start_s - 1e-9:
                yield ImageFrame(index, time_s, path, self.image_size)


Source = VideoSource | ImageFolder


def open_sources(paths: Mapping[str, Path], fps: float | None) -> dict[str, Source]:
    """Open the video file or the folder of images of every camera.

    Args:
        paths: camera id to file or folder.
        fps: images per second of the folders.

    Raises:
        InputError: naming what is wrong; without `fps` where there is a folder.
    """
    folders = {name: _numbered(path) for name, path in paths.items() if path.is_dir()}
    if folders and fps is None:
        raise InputError("--fps", "missing", "the frame rate of the image folders, such as 25")
    first = min((min(files) for files in folders.values()), default=0)
    opened: dict[str, Source] = {}
    for name, path in paths.items():
        if name not in folders:
            opened[name] = open_video(path)
            continue
        image = _read(next(iter(folders[name].values())))
        size = image.shape[1], image.shape[0]
        opened[name] = ImageFolder(path, fps or 0.0, size, folders[name], first)
    return opened


def _numbered(folder: Path) -> dict[int, Path]:
    """Return the images of a folder by the last number in their names, in rising order."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in KINDS:
            continue
        number = frame_number(path.name)
        if number in found:
            raise InputError(f"{path}: number {number} appears twice, as {found[number].name} too")
        found[number] = path
    if not found:
        raise InputError(
            f"{folder}: found no image ({', '.join(KINDS)}), expected one per frame, or a video"
        )
    return dict(sorted(found.items()))


def _read(path: Path) -> NDArray[np.uint8]:
    import cv2

    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{path}: cannot be read as an image")
    if image.shape[0] * image.shape[1] > MAX_PIXELS:
        raise InputError(f"{path}: found {image.shape[1]}x{image.shape[0]} pixels, too many")
    return np.ascontiguousarray(image[..., ::-1])
