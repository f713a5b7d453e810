"""Poses that a system collected -> clips: smoothed to aim at, as they were to start from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.edge.learn.ring_buffer import Chunk
from e3pose.model.skeleton import Skeleton
from e3pose.predict.normalise import common_columns
from e3pose_lab.prediction.normalise import to_common
from e3pose_lab.train.smooth import smooth
from e3pose_lab.train.windows import Clip

LEAST_SCORE = 0.2  # a joint that was hardly seen is no example; in a history it may stand


def collected_clips(
    chunks: Sequence[Chunk], skeleton: Skeleton, interval_s: float, shortest: int
) -> list[Clip]:
    """Return the motion of everybody in some chunks that follow each other.

    Args:
        chunks: oldest first; people are followed from one into the next.
        skeleton: of the poses.
        interval_s: seconds per slot.
        shortest: slots of the shortest clip of use.
    """
    rows: dict[tuple[int, int], list[tuple[NDArray[np.int64], Floats, Floats]]] = {}
    for chunk in chunks:
        for track in np.unique(chunk.people.track_ids).tolist():
            his = chunk.people.track_ids == track
            part = (
                chunk.slots[his],
                chunk.people.joints_m[his].astype(np.float64),
                chunk.people.scores[his],
            )
            rows.setdefault((chunk.run, track), []).append(part)
    columns = common_columns(skeleton)
    clips = []
    for parts in rows.values():
        slots = np.concatenate([part[0] for part in parts])
        breaks = np.flatnonzero(np.diff(slots) * interval_s > 1.0) + 1
        joints = np.concatenate([part[1] for part in parts])
        scores = np.concatenate([part[2] for part in parts])
        for some in np.split(np.arange(len(slots)), breaks):
            shape = (slots[some[-1]] - slots[some[0]] + 1, len(skeleton), 3)
            given = np.full(shape, np.nan)
            given[slots[some] - slots[some[0]]] = joints[some]
            sure = np.full(shape, np.nan)
            good = scores[some, :, None] >= LEAST_SCORE
            sure[slots[some] - slots[some[0]]] = np.where(good, joints[some], np.nan)
            target = to_common(smooth(sure, interval_s), columns)
            errors = (to_common(given, columns) - target)[:, None]
            whole = Clip(
                "the running system", target.astype(np.float32), 1 / interval_s,
                errors_m=errors.astype(np.float16),
            )  # fmt: skip
            clips += whole.without_gaps(shortest)
    return clips
