"""Resample a take to another frame rate by linear interpolation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from e3pose.base.quantities import check_within
from e3pose.model.take import MISSING, Motion, Take

FPS = (0.1, 1000.0)
SAME = 1e-6  # of a slot: a frame as near to a slot is that slot


def resampled(take: Take, fps: float) -> Take:
    """Return the take at `fps` frames per second; frame 0 is slot 0, as before.

    A joint that one of the two frames around lacks is missing, so gaps neither close nor grow by
    more than a frame. Between two frames the less certain one says how sure and where from.

    Raises:
        InputError: for a frame rate outside the limits.
    """
    check_within("--fps", fps, *FPS)
    if abs(fps * take.interval_s - 1) < 1e-9:
        return take
    step = 1 / (fps * take.interval_s)  # slots per frame
    motions = tuple(_motion(motion, step) for motion in take.motions)
    kept = tuple(motion for motion in motions if motion is not None)
    return replace(take, interval_s=1 / fps, motions=kept)


def _motion(motion: Motion, step: float) -> Motion | None:
    first = math.ceil(motion.first / step - SAME)
    last = math.floor((motion.first + len(motion) - 1) / step + SAME)
    if last < first:  # shorter than a frame
        return None
    places = np.arange(first, last + 1) * step - motion.first
    before = np.clip(np.floor(places + SAME).astype(np.int64), 0, len(motion) - 1)
    share = places - before
    share = np.where(share < SAME, 0.0, share)
    after = np.where(share > 0, np.minimum(before + 1, len(motion) - 1), before)
    known = motion.known[before] & motion.known[after]
    weight = share[:, None, None]
    joints_m = (1 - weight) * motion.joints_m[before] + weight * motion.joints_m[after]
    return Motion(
        motion.track_id,
        first,
        np.where(known[..., None], joints_m, np.nan),
        np.where(known, np.fmax(motion.sigma_m[before], motion.sigma_m[after]), np.nan),
        np.where(known, np.minimum(motion.scores[before], motion.scores[after]), 0.0),
        np.where(known, np.maximum(motion.origin[before], motion.origin[after]), MISSING).astype(
            np.uint8
        ),
    )
