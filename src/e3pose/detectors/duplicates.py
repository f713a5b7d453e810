"""Detections that are the same person twice."""

from __future__ import annotations

import numpy as np

from e3pose.model.pose import Poses2D

SAME_SHARE = 0.1  # of a person's size: poses nearer to each other on average are one person


def without_duplicates(found: Poses2D) -> Poses2D:
    """Return each person once, in the order given: of the same keypoints those of higher scores.

    Unlike an overlap of boxes, this keeps people who stand behind one another.
    """
    points, seen = found.keypoints_px, found.scores > 0
    kept: list[int] = []
    for person in np.argsort(-found.scores.sum(axis=1), kind="stable").tolist():
        if not seen[person].any():
            continue
        size = float(np.ptp(points[person, seen[person]], axis=0).max())
        both = seen[kept] & seen[person]
        apart = np.where(both, np.linalg.norm(points[kept] - points[person], axis=-1), 0.0)
        mean = apart.sum(axis=1) / np.maximum(both.sum(axis=1), 1)
        if not (both.any(axis=1) & (mean < SAME_SHARE * size)).any():
            kept.append(person)
    order = sorted(kept)
    return Poses2D(points[order], found.scores[order])
