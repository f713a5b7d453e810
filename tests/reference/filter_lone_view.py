"""What one view alone tells of a person's distance: the plain form of `kernels/lone_view.py`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from tests.reference.filter_update import size_variances

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter.lone_view import SIZE_SHARE
from e3pose.estimate.filter.state import Belief, Model


def discount(
    before: Belief,
    after: Belief,
    cameras: Integers,
    assigned: NDArray[np.bool_],
    dt: float,
    model: Model,
) -> Belief:
    """Return the updated belief with the distance that one view implies counted as what repeats."""
    state, covariance, shared = after.state.copy(), after.covariance.copy(), after.shared.copy()
    root, sizes = model.tree.order[0], size_variances(before, model)
    for track in np.flatnonzero(assigned.sum(axis=0) == 1):
        centre_m = model.rig.centers_m[cameras[int(np.argmax(assigned[:, track]))]]
        away = before.state[track, root, :3] - centre_m
        far_m = np.linalg.norm(away)
        away = away / far_m
        across = np.linalg.svd(away[None])[2][1:]  # (2, 3) beside the line of sight
        old, new = before.covariance[track, root], after.covariance[track, root]
        oblique = np.linalg.solve(across @ old[:3, :3] @ across.T, across @ old[:3, :3] @ away)
        line = away - oblique @ across  # what the place in the image does not tell of
        seen_m2 = across @ (old[:3, :3] - new[:3, :3]) @ across.T
        had_m2 = away @ old[:3, :3] @ away - oblique @ seen_m2 @ oblique
        has_m2 = away @ new[:3, :3] @ away
        if not 0 < has_m2 < had_m2:
            continue
        gained = 1 / has_m2 - 1 / had_m2
        counted = 0.0
        if dt > 0:
            repeats = 1 / np.tanh(dt / (2 * model.noise.memory.lasting_s))
            counted = 1 / (1 / gained + (SIZE_SHARE**2 + sizes[track]) * far_m**2 * repeats)
        honest_m2 = 1 / (1 / had_m2 + counted)
        moved_m = line @ (after.state[track, root, :3] - before.state[track, root, :3])
        back_m = moved_m * (honest_m2 * counted / (has_m2 * gained) - 1)
        per_s = away @ old[:3, 3:] @ away / (away @ old[:3, :3] @ away)
        body = _along(state[track, :, :3] - centre_m, per_s)
        state[track] += back_m * body
        wider_m2 = honest_m2 - has_m2
        covariance[track] += wider_m2 * body[:, :, None] * body[:, None, :]
        for joint, parent in enumerate(model.tree.parents):
            if parent >= 0:
                shared[track, joint] += wider_m2 * np.outer(body[joint], body[parent])
    return replace(after, state=state, covariance=covariance, shared=shared)


def _along(from_camera: Floats, per_s: float) -> Floats:
    """Return `(num_joints, 6)`: a metre along each joint's line of sight, and what it is faster."""
    lines = from_camera / np.linalg.norm(from_camera, axis=-1, keepdims=True)
    return np.concatenate([lines, per_s * lines], axis=-1)
