"""Example windows at fixed ranks of the prediction error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import Skeleton
from e3pose.predict.base import Predictor
from e3pose_lab.prediction.motion import Motion, body_joints
from e3pose_lab.prediction.scores import PredictionSettings, window_ends

RANKED_LEAD = 10  # or the longest lead below it
SHARES = (0.5, 0.75, 0.95)  # of the windows that are predicted better than the one shown
MOST_WINDOWS = 200  # of each recording, evenly spread, to rank
LEAST_JOINTS = 10  # of fourteen, known in every slot that is shown


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """One person for a moment.

    Attributes:
        name: of the recording.
        skeleton: the convention of the joints.
        interval_s: seconds per slot.
        history_m: `(num_slots, num_joints, 3)` what predictors are given, oldest first.
        future_m: `(num_leads, 14, 3)` what then happened, body joints at the leads of the settings.
        error_m: mean error of the predictor that ranks.
    """

    name: str
    skeleton: Skeleton
    interval_s: float
    history_m: Floats
    future_m: Floats
    error_m: float


def sample_windows(
    motion: Motion, settings: PredictionSettings, predictor: Predictor
) -> list[Window]:
    """Return windows of a motion, evenly spread over it, with their error at `ranked_lead`.

    Args:
        motion: what really happened; histories are given as they are.
        settings: leads and the length of histories.
        predictor: for the motion's skeleton; the one that ranks.
    """
    leads = np.array(settings.leads)
    before = np.arange(1 - settings.history_slots, 1)
    rank = settings.leads.index(ranked_lead(settings))
    windows = []
    for joints_m in motion.people:
        ends = window_ends(joints_m, settings)
        ends = ends[ends + leads.max() < len(joints_m)]
        body = body_joints(joints_m, motion.skeleton)
        known = np.asarray(np.isfinite(body).all(axis=-1).sum(axis=-1) >= LEAST_JOINTS)
        ends = ends[known[ends] & known[ends[:, None] + leads].all(axis=-1)]
        most = max(1, MOST_WINDOWS // len(motion.people))
        ends = ends[np.unique(np.linspace(0, len(ends) - 1, most).astype(int))] if len(ends) else []
        if not len(ends):
            continue
        history = joints_m[np.asarray(ends)[:, None] + before]
        future = body[np.asarray(ends)[:, None] + leads]
        result = predictor.predict(
            np.swapaxes(history, 0, 1), motion.interval_s, int(leads[rank])
        ).joints_m[-1]
        apart = np.linalg.norm(body_joints(result, motion.skeleton) - future[:, rank], axis=-1)
        errors = np.nanmean(np.where(np.isfinite(apart).any(axis=-1)[:, None], apart, np.inf), -1)
        windows += [
            Window(motion.name, motion.skeleton, motion.interval_s, *parts)
            for parts in zip(history, future, errors.tolist(), strict=True)
        ]
    return windows


def ranked_lead(settings: PredictionSettings) -> int:
    """Return the lead by whose error windows are ranked."""
    below = [lead for lead in settings.leads if lead <= RANKED_LEAD]
    return max(below) if below else min(settings.leads)


def choose_windows(
    windows: Sequence[Window], shares: Sequence[float] = SHARES
) -> list[tuple[float, Window]]:
    """Return, for each of `shares`, the window than which that share is predicted better."""
    ranked = sorted(windows, key=lambda window: window.error_m)
    return [(share, ranked[int(share * (len(ranked) - 1))]) for share in shares] if ranked else []


def foresee(window: Window, predictor: Predictor, leads: Sequence[int]) -> Floats:
    """Return `(num_leads, 14, 3)`: where a predictor for the window's skeleton sees the body."""
    result = predictor.predict(window.history_m[:, None], window.interval_s, max(leads))
    return body_joints(result.joints_m[np.array(leads) - 1, 0], window.skeleton)
