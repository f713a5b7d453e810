"""Requests for looks by consumers of records: weights of tracks, and extra cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.model.look_request import LookRequest
from e3pose.select.expected_information import Foresight
from e3pose.select.policies.base import Selection, Situation


def asked_for(foresight: Foresight, request: LookRequest) -> Foresight:
    """Restrict the foresight to the requested tracks, if any is present."""
    asked = np.isin(foresight.people.track_ids, request.tracks)
    weights = np.where(asked, foresight.weights, 0.0) if asked.any() else foresight.weights
    return replace(foresight, weights=weights)


def with_requested(decision: Selection, situation: Situation, request: LookRequest) -> Selection:
    """Return a selection raised to the requested number of cameras, the most informative ones.

    Args:
        decision: `(num_cameras,)` by the policy.
        situation: of the slot; without a foresight the policy alone decides.
        request: what is asked for.
    """
    foresight = situation.foresight
    if foresight is None or not request.cameras or decision.sum() >= request.cameras:
        return decision
    free = situation.online & ~decision
    if not free.any():
        return decision
    decision, asked = decision.copy(), asked_for(foresight, request)
    while decision.sum() < request.cameras and free.any():
        camera = int(np.argmax(np.where(free, asked.gains_nats(decision), -np.inf)))
        decision[camera], free[camera] = True, False
    return decision
