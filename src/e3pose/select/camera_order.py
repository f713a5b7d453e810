"""The order of a round robin: cameras in turn from directions far apart."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig


def viewing_angles(rig: Rig) -> Floats:
    """Return `(num_cameras, num_cameras)` angles in radians between the cameras' directions.

    A direction leads from the scene's centre, the point nearest to all optical axes, to a camera.
    """
    centers = rig.centers_m
    axes = np.stack([camera.R[2] for camera in rig.cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # Axes that are nearly parallel meet nowhere: a little pull keeps the point among the cameras.
    pull = 1e-3 * len(rig) * np.eye(3)
    right = (across @ centers[..., None]).sum(axis=0)[:, 0] + pull @ centers.mean(axis=0)
    middle = np.linalg.solve(across.sum(axis=0) + pull, right)
    towards = centers - middle
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.arccos(np.clip(towards @ towards.T, -1, 1)))


@lru_cache(maxsize=64)
def spread_order(rig: Rig) -> tuple[int, ...]:
    """Order the cameras so that each is far in viewing angle from the few before it.

    The cameras are sorted by azimuth around the scene's centre and taken in strides; of all strides
    the one is kept whose neighbours in the order, round and round, look from the most different
    directions, the nearest neighbours counting most.
    """
    angles = viewing_angles(rig)
    centers = rig.centers_m - rig.centers_m.mean(axis=0)
    around = np.argsort(np.arctan2(centers[:, 1], centers[:, 0]), kind="stable")
    orders = [
        _strided(np.roll(around, -start), stride)
        for stride in range(1, max(2, len(rig) // 2 + 1))
        for start in range(int(np.gcd(stride, len(rig))))
    ]
    likeness = np.exp(-((angles / (np.pi / 3)) ** 2))
    costs = [_cost(likeness, order) for order in orders]
    best = orders[int(np.argmin(np.round(costs, 9)))]
    first = int(np.flatnonzero(best == 0)[0])
    return tuple(np.roll(best, -first).tolist())


def _strided(around: NDArray[np.int64], stride: int) -> NDArray[np.int64]:
    rounds = np.gcd(stride, len(around))
    steps = np.arange(len(around) // rounds) * stride
    return np.concatenate([around[(start + steps) % len(around)] for start in range(rounds)])


def _cost(likeness: Floats, order: NDArray[np.int64]) -> float:
    lags = range(1, len(order))
    return float(sum(likeness[order, np.roll(order, lag)].mean() / 3 ** (lag - 1) for lag in lags))
