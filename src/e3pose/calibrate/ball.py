"""Find balls in pictures, one of a colour: that of a hue, or the brightest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.camera.source import open_video

# Hue in OpenCV's degrees (0 to 180), from and to; a range may pass through zero.
HUES: Mapping[str, tuple[int, int]] = {
    "red": (172, 8), "orange": (8, 20), "yellow": (20, 34), "green": (38, 85),
    "blue": (95, 128), "pink": (140, 172),
}  # fmt: skip
COLOURS = ("bright", *HUES)
BRIGHT = 235  # of 255
MIN_SATURATION, MIN_VALUE = 110, 70
MIN_AREA = 6  # pixels
MAX_SHARE = 0.02  # of the picture that a ball may take
ALONE = 0.4  # a second blob of this share of the area makes a picture ambiguous
ROUND = 0.55  # share of its box that a disc fills is 0.79


def find_ball(image: NDArray[np.uint8], colour: str) -> Floats:
    """Return the `(2,)` pixel of the ball's middle; NaN if none, or more than one, is there.

    Args:
        image: `(height, width, 3)` RGB.
        colour: one of `COLOURS`.
    """
    import cv2

    if colour == "bright":
        mask = image.min(axis=-1) >= BRIGHT
    else:
        hue, saturation, value = np.moveaxis(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), -1, 0)
        low, high = HUES[colour]
        inside = (hue >= low) & (hue <= high) if low < high else (hue >= low) | (hue <= high)
        mask = inside & (saturation >= MIN_SATURATION) & (value >= MIN_VALUE)
    number, _, stats, middles = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if number < 2:
        return np.full(2, np.nan)
    areas = stats[1:, cv2.CC_STAT_AREA]
    order = np.argsort(-areas)
    largest = int(order[0])
    width, height = stats[largest + 1, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    clear = len(order) == 1 or areas[order[1]] < ALONE * areas[largest]
    round_enough = areas[largest] >= ROUND * width * height and max(width, height) <= 2.5 * min(
        width, height
    )
    if not (MIN_AREA <= areas[largest] <= MAX_SHARE * mask.size and clear and round_enough):
        return np.full(2, np.nan)
    return np.asarray(middles[largest + 1], dtype=np.float64)


def track_balls(
    path: Path, times_s: Floats, colours: Sequence[str]
) -> tuple[Floats, tuple[int, int]]:
    """Return `(num_times, num_colours, 2)` pixels in a video's nearest frames, and their size.

    Args:
        path: the video.
        times_s: `(num_times,)` rising, seconds since its first frame.
        colours: of `COLOURS`, a ball each.
    """
    source = open_video(path)
    points = np.full((len(times_s), len(colours), 2), np.nan)
    place = 0
    for frame in source:
        while place < len(times_s) and times_s[place] < frame.time_s - 0.5 / source.rate - 1e-9:
            place += 1
        if place == len(times_s):
            break
        if abs(times_s[place] - frame.time_s) <= 0.5 / source.rate + 1e-9:
            points[place] = [find_ball(frame.image, colour) for colour in colours]
            place += 1
    return points, source.image_size


def check_colours(option: str, colours: Sequence[str]) -> None:
    """Raise `InputError` for a colour that no ball can have."""
    for colour in colours:
        if colour not in COLOURS:
            raise InputError(option, repr(colour[:20]), f"one of {', '.join(COLOURS)}")
