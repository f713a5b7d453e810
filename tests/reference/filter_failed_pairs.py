"""Detections that never become a person, by their place in the image, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.failed_pairs import COLUMNS, FADES_S, MOST, ROWS
from e3pose.estimate.filter.leftovers import SURE_SCORE
from e3pose.estimate.filter.state import Leftovers, Model
from e3pose.model.overlap import overlap


def cells(waiting: Leftovers, model: Model) -> list[tuple[int, int, int]]:
    """Return camera, row and column of each detection."""
    found = []
    for camera, keypoints, scores in zip(
        waiting.cameras.tolist(), waiting.keypoints_px, waiting.scores, strict=True
    ):
        middle = keypoints[scores > SURE_SCORE].mean(axis=0) / model.rig.image_sizes[camera]
        column, row = np.clip(middle * (COLUMNS, ROWS), 0, (COLUMNS - 1, ROWS - 1)).astype(int)
        found.append((camera, int(row), int(column)))
    return found


def count_failures(
    failed: Floats, waiting: Leftovers, taken: set[int], dt: float, cameras: NDArray[np.int64],
    model: Model,
) -> Floats:  # fmt: skip
    """Return `Belief.failed_pairs` after a slot with views of `cameras`; `taken` started tracks."""
    failed = failed * np.exp(-dt / FADES_S)
    places = cells(waiting, model)
    newest = {c: waiting.times_s[waiting.cameras == c].max() for c in set(waiting.cameras.tolist())}
    fruitless = {
        place
        for index, place in enumerate(places)
        if index not in taken and waiting.times_s[index] == newest[place[0]]
    }
    for place in fruitless:
        met = 1 - np.prod(1 - overlap(model.rig)[place[0], cameras])
        failed[place] = min(failed[place] + met, MOST)
    for index in taken:
        failed[places[index]] = 0.0
    return failed
