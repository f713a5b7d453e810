"""Who exists: people are confirmed, coasted and ended by the views that should show them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from tests.reference import filter_blindness

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter import blindness
from e3pose.estimate.filter.blindness import FASTEST_S
from e3pose.estimate.filter.existence import (
    CHEST_M,
    CONFIRM_CAMERAS,
    CONFIRM_HITS,
    DELIVERED_LASTS_S,
    DELIVERED_PRIOR,
    DELIVERED_RATE,
    END_EXISTENCE,
    INSIDE_JOINTS,
    LEARN_RATE,
    MOST_ALONE,
    MOST_WIDE_M,
    SAME_M,
)
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.projection import MIN_DEPTH_M, project


def count_views(
    belief: Belief,
    predicted: Belief,
    cameras: Integers,
    fits: Floats,
    hits: Flags,
    shares: Floats,
    dt: float,
    model: Model,
) -> Belief:
    """Count for each track the views that showed it and those that should have.

    A camera that sent no view says nothing, nor does one that looks elsewhere, and one that seldom
    shows people at this place says little.
    """
    expected = _inside(predicted, cameras, model)
    share = min(1.0, dt / FASTEST_S)
    places_m = predicted.state[:, model.tree.levels[0][0], :2]
    proof = np.where(
        hits, 1.0, filter_blindness.proof(belief.detection_map, cameras, places_m, model.corner_m)
    )
    existence, seen_by = belief.existence, belief.seen_by.copy()
    last_seen_s = belief.last_seen_s + dt
    forgotten = 1 - np.exp(-dt / DELIVERED_LASTS_S)
    delivered = belief.delivered + forgotten * (DELIVERED_PRIOR - belief.delivered)
    for view, camera in enumerate(cameras.tolist()):
        hit, seen = hits[view], hits[view] | expected[view]
        rate = LEARN_RATE * share * np.where(seen, proof[view], 0.0)
        existence = existence + rate * (fits[view] - existence)
        seen_by[:, camera] |= hit
        last_seen_s[hit, camera] = 0.0
        delivered[seen, camera] += DELIVERED_RATE * (shares[view] - delivered[:, camera])[seen]
    alone = _alone(belief, hits, share)
    total = belief.hits + hits.sum(axis=0)
    confirmed = belief.confirmed | (seen_by.sum(axis=1) >= CONFIRM_CAMERAS)
    confirmed |= total >= CONFIRM_HITS
    looks, shown = np.zeros_like(belief.missed), np.zeros_like(belief.missed)
    looks[:, cameras] = share * (hits | expected).T
    shown[:, cameras] = share * hits.T
    missed = belief.missed + looks - shown
    there: Flags = np.asarray(hits.any(axis=0))
    recent = (last_seen_s < blindness.PROOF_S).sum(axis=1)
    taught = np.asarray(there & confirmed & (recent >= blindness.PROOF_CAMERAS))[:, None]
    detection_map = filter_blindness.learn(
        belief.detection_map,
        places_m,
        np.where(taught, missed + shown, 0.0),
        np.where(taught, shown, 0.0),
        model.corner_m,
    )
    return replace(
        belief,
        existence=existence,
        seen_by=seen_by,
        last_seen_s=last_seen_s,
        delivered=delivered,
        missed=np.where(there[:, None], 0.0, missed),
        detection_map=detection_map,
        hits=total,
        alone=alone,
        confirmed=confirmed,
    )


def end(belief: Belief, model: Model) -> Belief:
    """Drop tracks that views no longer show, or that are no one person."""
    keep: Any = belief.existence > END_EXISTENCE
    keep &= (belief.unmeasured_s <= blindness.PROOF_S).any(axis=-1) & ~_doubles(belief)
    keep &= ~wide(belief.state[..., :3], model)
    return replace(belief, **{n: c[keep] for n, c in belief.columns().items()})


def wide(joints_m: Floats, model: Model) -> Flags:
    """Return `(*batch)`: whose shoulders and hips are wider than anybody's."""
    across = joints_m[..., model.girdles[:, 0], :] - joints_m[..., model.girdles[:, 1], :]
    return np.asarray(np.linalg.norm(across, axis=-1).sum(axis=-1) > MOST_WIDE_M)


def _inside(belief: Belief, cameras: Integers, model: Model) -> Flags:
    pixels, depth, _ = project(belief.state[..., :3], model.rig.projections[cameras])
    size = model.rig.image_sizes[cameras].reshape(-1, 1, 1, 2)
    inside = ((pixels > 0) & (pixels < size)).all(axis=-1) & (depth > MIN_DEPTH_M)
    return np.asarray(inside.sum(axis=-1) >= INSIDE_JOINTS)


def _alone(belief: Belief, hits: Flags, share: float) -> Floats:
    """Return `belief.alone` after a slot."""
    if len(belief) < 2:
        return np.zeros(len(belief))
    apart_m = _middles_apart_m(belief)
    nearest = apart_m.argmin(axis=1)
    both = (hits & hits[:, nearest]).any(axis=0)
    one = (hits ^ hits[:, nearest]).sum(axis=0)
    near = apart_m.min(axis=1) < CHEST_M
    return np.where(near & ~both, belief.alone + share * one, 0.0)


def _doubles(belief: Belief) -> Flags:
    positions: Floats = belief.state[..., :3]
    apart_m = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    same = np.median(apart_m, axis=-1) < SAME_M
    same |= (_middles_apart_m(belief) < CHEST_M) & (belief.alone > MOST_ALONE)[:, None]
    rows, others = np.nonzero(same)
    younger = (belief.hits[rows] < belief.hits[others]) | (
        (belief.hits[rows] == belief.hits[others]) & (rows > others)
    )
    double = np.zeros(len(belief), dtype=bool)
    double[rows[younger]] = True
    return double


def _middles_apart_m(belief: Belief) -> Floats:
    """Return `(num_tracks, num_tracks)` distances of bodies, inf of one to itself."""
    middles = belief.state[..., :3].mean(axis=1)
    apart_m: Floats = np.linalg.norm(middles[:, None] - middles[None], axis=-1)
    np.fill_diagonal(apart_m, np.inf)
    return apart_m
