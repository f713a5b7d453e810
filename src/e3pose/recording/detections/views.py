"""View series of a recording from numbered frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.recording import ViewSeries
from e3pose.recording.json_lines import PIXEL_LIMIT
from e3pose.recording.record import MAX_FPS, MAX_PEOPLE, MIN_FPS

MAX_SLOTS = 10_000_000
# OpenPose and AlphaPose exceed 1 by a few percent; beyond this it is not a score at all.
SCORE_EXCESS = 0.5


def poses_from_triples(triples: NDArray[np.float64], where: str) -> Poses2D:
    """Make a view of `(num_persons, num_joints, 3)` x, y, score, as detectors write them.

    A joint with score 0 or less is missing. Scores up to 1.5 are clipped to 1.

    Raises:
        InputError: naming `where`, on a number that is no score, no pixel, or not finite.
    """
    if len(triples) > MAX_PEOPLE:
        raise InputError(f"{where}: found {len(triples)} people, expected at most {MAX_PEOPLE}")
    if not np.isfinite(triples).all():
        raise InputError(f"{where}: keypoints: found a value that is not finite")
    scores = triples[..., 2]
    if (np.abs(scores - 0.5) > 0.5 + SCORE_EXCESS).any():
        worst = scores.flat[np.abs(scores - 0.5).argmax()]
        raise InputError(f"{where}: score: found {worst:g}, expected 0 to 1")
    if (np.abs(triples[..., :2]) > PIXEL_LIMIT).any():
        raise InputError(f"{where}: keypoints: found a coordinate beyond {PIXEL_LIMIT:g} px")
    return Poses2D(triples[..., :2], np.clip(scores, 0.0, 1.0))


def series_from_frames(
    frames: Sequence[Mapping[int, Poses2D]], fps: float, num_joints: int, where: str
) -> tuple[int, tuple[ViewSeries, ...]]:
    """Count slots from the first frame number that any camera has.

    Args:
        frames: per camera, frame number to view; an absent number is a lost view.
        fps: frames per second, from which times are counted.
        num_joints: joints of the skeleton.
        where: the source, for the error.

    Returns:
        Number of slots, and one series per camera.

    Raises:
        InputError: for no frame, or more slots than a recording holds.
    """
    numbers = [number for camera in frames for number in camera]
    if not numbers:
        raise InputError(f"{where}: found no frame, expected at least one")
    first, last = min(numbers), max(numbers)
    if last - first >= MAX_SLOTS:
        raise InputError(
            f"{where}: frame numbers: found {first} to {last}, expected at most {MAX_SLOTS} slots"
        )
    series = []
    for camera in frames:
        order = sorted(camera)
        slots = [number - first for number in order]
        times_s = [slot / fps for slot in slots]
        views = [camera[number] for number in order]
        series.append(ViewSeries.from_views(views, slots, times_s, num_joints))
    return last - first + 1, tuple(series)


def check_fps(fps: float) -> float:
    """Return `fps` if it is a frame rate; raise `InputError` if not."""
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError(f"--fps: found {fps:g}, expected a rate from {MIN_FPS:g} to {MAX_FPS:g}")
    return fps
