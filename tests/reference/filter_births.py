"""New people: two detections that nobody explains and that meet as one body in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tests.reference.filter_existence import wide
from tests.reference.filter_failed_pairs import count_failures
from tests.reference.filter_proportions import stature_m
from tests.reference.triangulate import triangulate

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.births import (
    MAX_ERROR_PX,
    MIN_EXTENT_M,
    SHARED_SCORE,
    START_EXISTENCE,
    START_JOINT_M,
    START_SPEED_MPS,
    START_TURN_MPS,
    START_UNSEEN_M,
    WALK_MPS,
)
from e3pose.estimate.filter.existence import DELIVERED_PRIOR
from e3pose.estimate.filter.leftovers import MIN_JOINTS, SURE_SCORE
from e3pose.estimate.filter.scratch import MAX_LEFTOVERS
from e3pose.estimate.filter.state import APART_M, MAX_TRACKS, Belief, Leftovers, Model
from e3pose.model.projection import project
from e3pose.model.proportions import LEAST_M, MOST_M


def give_birth(
    belief: Belief, fresh: Leftovers, cameras: Integers, dt: float, model: Model
) -> Belief:
    """Start people from pairs of leftovers, best pair first, and keep the rest waiting."""
    sure = (fresh.scores > SURE_SCORE).sum(axis=1) >= MIN_JOINTS
    fresh = fresh.take(sure)
    fresh = fresh.take(_spread(fresh))
    old = belief.leftovers.take(belief.leftovers.times_s > belief.time_s - model.wait_s)
    waiting = fresh.join(old).take(np.arange(min(MAX_LEFTOVERS, len(fresh) + len(old))))
    order = np.lexsort((waiting.scores.sum(axis=1), waiting.cameras, -waiting.times_s))
    waiting = waiting.take(order)
    pairs = _pairs(belief, waiting, model)
    taken: set[int] = set()
    for _, a, b, joints_m in sorted(pairs, key=lambda pair: pair[:3]):
        moved_m = WALK_MPS * abs(float(waiting.times_s[a] - waiting.times_s[b]))
        if {a, b} & taken or len(belief) >= MAX_TRACKS or not _apart(belief, joints_m):
            continue
        taken |= {a, b}
        belief = _start(belief, joints_m, moved_m, waiting.cameras[[a, b]], model)
    failed = count_failures(belief.failed_pairs, waiting, taken, dt, cameras, model)
    keep = np.array([i not in taken for i in range(len(waiting))], dtype=bool)
    return replace(belief, leftovers=waiting.take(keep), failed_pairs=failed)


def _spread(fresh: Leftovers) -> Integers:
    """Return the rows of at most `MAX_LEFTOVERS`, as many of each camera, by falling score."""
    if len(fresh) <= MAX_LEFTOVERS:
        return np.arange(len(fresh))
    order = np.lexsort((-fresh.scores.sum(axis=1), fresh.cameras))
    ranks = np.zeros(len(fresh), dtype=np.int64)  # among those of the same camera
    ranks[order] = np.arange(len(fresh)) - np.searchsorted(
        fresh.cameras[order], fresh.cameras[order]
    )
    return np.sort(np.lexsort((fresh.cameras, ranks))[:MAX_LEFTOVERS])


def _pairs(
    belief: Belief, waiting: Leftovers, model: Model
) -> list[tuple[float, int, int, Floats]]:
    """Return the pairs that may be one person: how badly they fit, their rows, and their joints."""
    first, second = np.triu_indices(len(waiting), k=1)
    new = waiting.times_s == belief.time_s
    possible = (waiting.cameras[first] != waiting.cameras[second]) & (new[first] | new[second])
    pairs = []
    for a, b in zip(first[possible].tolist(), second[possible].tolist(), strict=True):
        rows = np.array([a, b])
        scores = waiting.scores[rows]
        shared = (scores > SHARED_SCORE).all(axis=0)
        if shared.sum() < MIN_JOINTS:
            continue
        keypoints = np.where(shared[:, None], waiting.keypoints_px[rows], np.nan)
        projections = model.rig.projections[waiting.cameras[rows]]
        joints_m = triangulate(keypoints, scores * shared, projections)
        scales = model.scales[waiting.cameras[rows]].reshape(2, 1)
        pixels = project(np.nan_to_num(joints_m), projections)[0]
        error = np.linalg.norm(pixels - keypoints, axis=-1) / scales
        error = np.where(np.isfinite(joints_m[:, 0]), error, np.nan).max(axis=0)
        good = error < MAX_ERROR_PX
        if good.sum() < MIN_JOINTS or np.nanmedian(error) > MAX_ERROR_PX:
            continue
        if not _human(joints_m, model):
            continue
        fit = float(np.nanmedian(error) / np.sqrt(np.isfinite(error).sum()))
        pairs.append((fit, a, b, joints_m))
    return pairs


def _human(joints_m: Floats, model: Model) -> bool:
    extent = (np.nanmax(joints_m, axis=0) - np.nanmin(joints_m, axis=0)).max()
    stature = stature_m(joints_m, model.proportions)
    human = stature == 0 or LEAST_M <= stature <= MOST_M
    return bool(MIN_EXTENT_M <= extent <= MOST_M) and human and not wide(joints_m, model)


def _apart(belief: Belief, joints_m: Floats) -> bool:
    known = np.isfinite(joints_m[:, 0])
    distance = np.linalg.norm(belief.state[:, known, :3] - joints_m[known], axis=-1)
    return bool((distance.mean(axis=-1) >= APART_M).all()) if len(belief) else True


def _start(
    belief: Belief, joints_m: Floats, moved_m: float, cameras: NDArray[np.int64], model: Model
) -> Belief:
    middle = np.nanmedian(joints_m, axis=0)
    known = np.isfinite(joints_m[:, 0])
    state = np.zeros((len(known), 6))
    state[:, :3] = np.where(known[:, None], joints_m, middle)
    covariance = np.zeros((len(known), 6, 6))
    spread = np.where(known, START_JOINT_M, START_UNSEEN_M) ** 2
    covariance[:, :3, :3] = (spread + moved_m**2)[:, None, None] * np.eye(3)
    depth = np.zeros(len(known))
    for steps, level in enumerate(model.tree.levels):
        depth[level] = steps
    speed = START_SPEED_MPS**2 + depth * START_TURN_MPS**2
    covariance[:, 3:, 3:] = speed[:, None, None] * np.eye(3)
    # All start with the velocity of their parents, and all have moved together.
    has_parent = (depth > 0)[:, None, None]
    shared = np.zeros_like(covariance)
    shared[:, :3, :3] = has_parent * moved_m**2 * np.eye(3)
    shared[:, 3:, 3:] = has_parent * (speed - START_TURN_MPS**2)[:, None, None] * np.eye(3)
    seen_by = np.zeros(len(model.rig), dtype=bool)
    seen_by[cameras] = True
    no_bones = np.zeros(len(model.proportions.bones))
    new = {
        "track_ids": belief.next_id,
        "state": state,
        "covariance": covariance,
        "shared": shared,
        "unmeasured_s": np.where(known, 0.0, np.inf),
        "drift_share": np.ones(len(known)),
        "existence": START_EXISTENCE,
        "hits": 2,
        "alone": 0.0,
        "seen_by": seen_by,
        "last_seen_s": np.where(seen_by, 0.0, np.inf),
        "bias_px": np.zeros((len(model.rig), len(known), 2)),
        "delivered": np.full(len(model.rig), DELIVERED_PRIOR),
        "missed": np.zeros(len(model.rig)),
        "confirmed": False,
        "mirrored": np.zeros(2),
        "bones_m": no_bones,
        "bone_counts": no_bones,
        "innovations": np.zeros(2),
        "agility": np.zeros(len(known)),
        "corrected_m": np.zeros((len(known), 3)),
    }
    columns = {
        name: np.concatenate([column, np.asarray(new[name], dtype=column.dtype)[None]])
        for name, column in belief.columns().items()
    }
    return replace(belief, next_id=belief.next_id + 1, **columns)  # type: ignore[arg-type]
