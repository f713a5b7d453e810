"""A take as a pandas DataFrame, for notebooks."""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.model.take import MISSING, ORIGINS, Take

COLUMNS = ("slot", "seconds", "track", "joint", "x", "y", "z", "sigma", "score", "origin")


def to_frame(take: Take) -> Any:
    """Return a take as a DataFrame with a row per slot, person and known joint.

    Columns: `slot`, `seconds` (after slot 0), `track`, `joint`, `x`, `y`, `z` and `sigma` in
    metres, `score`, `origin` (`measured`, `predicted` or `filled`), and `time` where the take
    knows when it was. Needs pandas, of the extra `notebook`.
    """
    import pandas

    parts = []
    joints, origins = np.array(take.skeleton.joints), np.array(ORIGINS)
    for motion in take.motions:
        rows, index = np.nonzero(motion.origin != MISSING)
        slots = motion.first + rows
        columns = (
            slots,
            slots * take.interval_s,
            np.full(len(rows), motion.track_id),
            joints[index],
            *motion.joints_m[rows, index].T,
            motion.sigma_m[rows, index],
            motion.scores[rows, index],
            origins[motion.origin[rows, index]],
        )
        parts.append(pandas.DataFrame(dict(zip(COLUMNS, columns, strict=True))))
    frame = pandas.concat(parts) if parts else pandas.DataFrame(columns=list(COLUMNS))
    if take.started_ns is not None:
        times_ns = take.started_ns + np.round(frame["seconds"].astype(float) * 1e9).astype("int64")
        frame["time"] = pandas.to_datetime(times_ns, utc=True)
    return frame.sort_values(["slot", "track"], kind="stable", ignore_index=True)
