"""Outlooks of people who stand still, for foresights of policies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.base import Expected, Outlook
from e3pose.model.noise import ErrorMemory
from e3pose.select.policies import Situation


def standing(joints_m: Floats, num_cameras: int, sigma_m: float = 0.1, **more: Any) -> Outlook:
    """Return people known to `sigma_m` along each axis; `more` are other arrays of `Expected`."""
    people, shape = len(joints_m), (len(joints_m), num_cameras)
    covariance = np.zeros((*joints_m.shape[:2], 6, 6))
    covariance[..., :3, :3] = sigma_m**2 * np.eye(3)
    expected = Expected(
        track_ids=np.arange(people) + 10,
        confirmed=np.ones(people, dtype=bool),
        joints_m=joints_m,
        covariance=covariance,
        drift_m2ps3=np.zeros(joints_m.shape[:2]),
        velocity_lasts_s=np.full(joints_m.shape[1], 0.8),
        delivered=np.ones(shape),
        shows=np.ones(shape),
        last_seen_s=np.full(shape, np.inf),
        sigma_px=np.full(num_cameras, 3.0),
    )
    return Outlook(
        expected=expected._replace(**more),
        has_memory=True,
        detection_map=None,
        memory=ErrorMemory(),
        bias_share=0.4,
        unexplained=np.zeros(num_cameras, dtype=np.int64),
        unexplained_s=np.full(num_cameras, np.inf),
        wait_s=0.14,
    )


def known(outlook: Outlook, **arrays: Any) -> Outlook:
    """Return an outlook with other arrays of `Expected`."""
    return replace(outlook, expected=outlook.expected._replace(**arrays))


def situation(num_cameras: int, **more: Any) -> Situation:
    """Return a slot in which nothing prefers a camera; `more` are other fields."""
    none = np.zeros(num_cameras)
    plain = Situation(
        slot=7,
        interval_s=0.04,
        online=np.ones(num_cameras, dtype=bool),
        occlusion=none,
        own_occlusion=none,
        unseen_slots=np.ones(num_cameras, dtype=np.int64),
        visibility=np.ones((num_cameras, 1)),
        deficit=none,
        budget=np.full(num_cameras, 0.8),
        price=none,
    )
    return replace(plain, **more)
