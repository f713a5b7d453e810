"""Tracklets: people tracked within one view, in pixels, as long as identity is unambiguous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.base.nan_statistics import median_of_known
from e3pose.recording.record import ViewSeries

MOST_STEP = 0.25  # of a person's size, that joints move from slot to slot
STEP_PER_GAP = 0.1  # more for each slot without the person
MOST_GAP_S = 0.4  # without the person, of a camera that detects in every slot
GAP_PER_INTERVAL = 3.0  # intervals between detections, of one that is seldom active
LONGEST_GAP_S = 1.5
CLEAR = 1.8  # the second best must be this many times farther, or the tracklet ends
MIN_JOINTS = 5
MIN_LENGTH = 5


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """One person in one view.

    Attributes:
        camera: index of the camera.
        slots: `(n,)` rising.
        rows: `(n,)` of the view's poses.
    """

    camera: int
    slots: NDArray[np.int64]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.slots)


def find_tracklets(camera: int, series: ViewSeries, fps: float) -> list[Tracklet]:
    """Link the people of one view from slot to slot.

    A tracklet ends where somebody else is nearly as near: it is better cut than mixed.

    Args:
        camera: index of the camera.
        series: what it saw.
        fps: slots per second.
    """
    # A person may be missing for so many slots, more if detections are rare.
    steps = np.diff(series.slots)
    often = GAP_PER_INTERVAL * float(np.median(steps)) if len(steps) else 0.0
    most_gap = max(1, round(max(MOST_GAP_S * fps, min(often, LONGEST_GAP_S * fps))))
    open_rows: list[list[int]] = []
    open_slots: list[list[int]] = []
    finished: list[tuple[list[int], list[int]]] = []
    sizes = _sizes(series.keypoints_px)
    for frame, slot in enumerate(series.slots.tolist()):
        rows = np.arange(series.starts[frame], series.starts[frame + 1])
        still = [i for i, slots in enumerate(open_slots) if slot - slots[-1] <= most_gap]
        for i in range(len(open_slots)):
            if i not in still:
                finished.append((open_slots[i], open_rows[i]))
        open_slots, open_rows = [open_slots[i] for i in still], [open_rows[i] for i in still]
        taken: set[int] = set()
        if open_rows and len(rows):
            last = np.array([r[-1] for r in open_rows])
            gaps = np.array([slot - s[-1] for s in open_slots])
            cost = _distances(series.keypoints_px[last], series.keypoints_px[rows])
            cost = cost / np.maximum(sizes[last][:, None], 1.0)
            limit = MOST_STEP + STEP_PER_GAP * (gaps - 1)
            for i, j in zip(*linear_sum_assignment(np.nan_to_num(cost, nan=1e3)), strict=True):
                if cost[i, j] <= limit[i] and _clear(cost, i, j):
                    open_rows[i].append(int(rows[j]))
                    open_slots[i].append(slot)
                    taken.add(int(j))
                elif cost[i, j] <= limit[i]:
                    open_slots[i][-1] = min(open_slots[i][-1], slot)
        for j, row in enumerate(rows.tolist()):
            if j not in taken:
                open_rows.append([row])
                open_slots.append([slot])
    finished += list(zip(open_slots, open_rows, strict=True))
    return [
        Tracklet(camera, np.array(slots, dtype=np.int64), np.array(rows, dtype=np.int64))
        for slots, rows in finished
        if len(slots) >= MIN_LENGTH
    ]


def _clear(cost: Floats, i: int, j: int) -> bool:
    others = np.concatenate([np.delete(cost[i], j), np.delete(cost[:, j], i)])
    others = others[np.isfinite(others)]
    return len(others) == 0 or float(others.min()) > CLEAR * cost[i, j] or cost[i, j] < 0.03


def _sizes(keypoints_px: Floats) -> Floats:
    """Return `(num_poses,)` the longer side of each person's box in pixels; 0 for nobody."""
    low = np.where(np.isfinite(keypoints_px), keypoints_px, np.inf).min(axis=1, initial=np.inf)
    high = np.where(np.isfinite(keypoints_px), keypoints_px, -np.inf).max(axis=1, initial=-np.inf)
    extent = (high - low).max(axis=-1, initial=0.0)
    return np.where(np.isfinite(extent), extent, 0.0)


def _distances(first: Floats, second: Floats) -> Floats:
    """Return `(n, m)` median distances over the joints that both have; NaN with too few."""
    apart = np.linalg.norm(first[:, None] - second[None], axis=-1)
    return median_of_known(apart, MIN_JOINTS)
