"""Find a board in the frames of a video, or in a folder of pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.board import Board, make_finder
from e3pose.camera.source import open_video, read_picture

Grey = NDArray[np.uint8]

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
MAX_PICTURES = 5000
PATCH = 5  # pixels around a corner in which its sharpness is measured


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """Where one camera saw the board.

    Attributes:
        camera_id: the camera.
        image_size: `(width, height)` in pixels.
        searched: how many frames were searched.
        times_s: `(num_views,)` when; the number of the picture in a folder.
        corners_px: `(num_views, num_corners, 2)`; NaN where a corner was not found.
        sharpness: `(num_views,)` steepest step of grey at a corner as a share of its contrast, per
            pixel; the median over the corners.
    """

    camera_id: str
    image_size: tuple[int, int]
    searched: int
    times_s: Floats
    corners_px: Floats
    sharpness: Floats


def find_board(
    camera_id: str,
    path: Path,
    board: Board,
    times_s: Floats | None = None,
    max_frames: int = 400,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> BoardViews:
    """Look for a board.

    Args:
        camera_id: the camera that filmed.
        path: a video, a picture or a folder of pictures. Videos are turned upright as players do.
        board: what to look for.
        times_s: rising times of the frames to search, the nearest ones; None for `max_frames`,
            evenly spread.
        max_frames: with `times_s` None.
        progress: takes frames done and in all.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    finder = make_finder(board)
    times, corners, sharp = [], [], []
    size, searched = (0, 0), 0
    for time_s, grey, total in _frames(path, times_s, max_frames):
        if size != (0, 0) and grey.shape[::-1] != size:
            raise InputError(
                f"{path}: image size: found {grey.shape[1]}x{grey.shape[0]} after "
                f"{size[0]}x{size[1]}, expected one size"
            )
        size = (grey.shape[1], grey.shape[0])
        searched += 1
        found = finder(grey)
        if np.isfinite(found).any():
            times.append(time_s)
            corners.append(found)
            sharp.append(_sharpness(grey, found[np.isfinite(found[:, 0])]))
        progress(searched, max(total, searched))
    number = (board.columns - 1) * (board.rows - 1)
    return BoardViews(
        camera_id,
        size,
        searched,
        np.array(times),
        np.array(corners).reshape(-1, number, 2),
        np.array(sharp),
    )


def _frames(
    path: Path, times_s: Floats | None, max_frames: int
) -> Iterator[tuple[float, Grey, int]]:
    """Yield time, picture and about how many there will be."""
    if path.is_dir() or path.suffix.lower() in PICTURES:
        yield from _pictures(path, times_s)
        return
    import cv2

    source = open_video(path)
    if times_s is None:
        stride = max(1, -(-source.num_frames // max_frames))
        total = -(-source.num_frames // stride)
        for frame in source:
            if frame.index % stride == 0:
                yield frame.time_s, cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), total
        return
    half = 0.5 / source.rate
    wanted = iter(times_s.tolist())
    time_s = next(wanted, None)
    for frame in source:
        while time_s is not None and time_s < frame.time_s - half - 1e-9:
            time_s = next(wanted, None)
        if time_s is None:
            return
        if abs(frame.time_s - time_s) <= half + 1e-9:
            yield time_s, cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), len(times_s)
            time_s = next(wanted, None)


def _pictures(path: Path, times_s: Floats | None) -> Iterator[tuple[float, Grey, int]]:

    files = [path]
    if path.is_dir():
        files = sorted(f for f in path.iterdir() if f.suffix.lower() in PICTURES and f.is_file())
    if not files or len(files) > MAX_PICTURES:
        raise InputError(
            f"{path}: found {len(files)} pictures, expected 1 to {MAX_PICTURES} of "
            f"{', '.join(PICTURES)}"
        )
    wanted = None if times_s is None else {round(time) for time in times_s.tolist()}
    for index, file in enumerate(files):
        if wanted is not None and index not in wanted:
            continue
        yield float(index), read_picture(file, grey=True), len(files)


def _sharpness(grey: Grey, corners_px: Floats) -> float:
    values = []
    for x, y in np.round(corners_px).astype(int).tolist():
        patch = grey[max(y - PATCH, 0) : y + PATCH + 1, max(x - PATCH, 0) : x + PATCH + 1]
        if min(patch.shape) < PATCH:
            continue
        levels = patch.astype(np.float64)
        contrast = np.ptp(levels)
        steepest = max(np.abs(np.diff(levels, axis=0)).max(), np.abs(np.diff(levels, axis=1)).max())
        values.append(steepest / max(contrast, 1.0))
    return float(np.median(values)) if values else 0.0
