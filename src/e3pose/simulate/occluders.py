"""Objects in a scene, which occlude people and obstruct their ways."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats


class Occluder(Protocol):
    """Something opaque that stands on the floor and does not move."""

    def blocks(self, start_m: Floats, end_m: Floats) -> NDArray[np.bool_]:
        """Return `(*batch)`: whether it cuts the straight line from `start_m` to `end_m`.

        Args:
            start_m: `(*batch, 3)` metres.
            end_m: `(*batch, 3)` metres.
        """
        ...

    def nearest(self, xy_m: Floats) -> Floats:
        """Return `(*batch, 2)`: the points of its footprint nearest to `(*batch, 2)`."""
        ...


@dataclass(frozen=True, slots=True)
class Pillar:
    """An upright round pillar standing on the floor, in metres."""

    x_m: float
    y_m: float
    radius_m: float
    height_m: float

    def blocks(self, start_m: Floats, end_m: Floats) -> NDArray[np.bool_]:
        """Return `(*batch)`: whether the pillar cuts the line between the points `(*batch, 3)`."""
        along = end_m - start_m
        offset = start_m[..., :2] - (self.x_m, self.y_m)
        a = (along[..., :2] ** 2).sum(axis=-1)
        b = (along[..., :2] * offset).sum(axis=-1)
        c = (offset**2).sum(axis=-1) - self.radius_m**2
        inside = b * b - a * c
        root = np.sqrt(np.maximum(inside, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            enter = np.where(a > 0, (-b - root) / a, np.where(c < 0, -np.inf, np.inf))
            leave = np.where(a > 0, (-b + root) / a, np.where(c < 0, np.inf, -np.inf))
        low, high = _slab(start_m[..., 2], along[..., 2], 0.0, self.height_m)
        meets = np.maximum(np.maximum(enter, low), 0.0) < np.minimum(np.minimum(leave, high), 1.0)
        return np.asarray(meets & ((inside > 0) | (a == 0)))

    def nearest(self, xy_m: Floats) -> Floats:
        """Return `(*batch, 2)`: the points of its footprint nearest to `(*batch, 2)`."""
        offset = xy_m - (self.x_m, self.y_m)
        distance = np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-12)
        return np.asarray(offset * np.minimum(self.radius_m / distance, 1) + (self.x_m, self.y_m))


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box, such as a cupboard, a wall or the top of a table, in metres and radians.

    Attributes:
        x_m: middle.
        y_m: middle.
        length_m: along x, before it is turned.
        width_m: along y, before it is turned.
        height_m: of its upper side above the floor.
        yaw: by which it is turned.
        bottom_m: height of its lower side: below, one sees through.
        overhang_m: how far feet go under its edges.
    """

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw: float = 0.0
    bottom_m: float = 0.0
    overhang_m: float = 0.0

    def blocks(self, start_m: Floats, end_m: Floats) -> NDArray[np.bool_]:
        """Return `(*batch)`: whether the box cuts the line between the points `(*batch, 3)`."""
        start = self._local(start_m[..., :2])
        along = self._local(end_m[..., :2]) - start
        rise = end_m[..., 2] - start_m[..., 2]
        enter, leave = _slab(start_m[..., 2], rise, self.bottom_m, self.height_m)
        for axis, size in enumerate((self.length_m, self.width_m)):
            low, high = _slab(start[..., axis], along[..., axis], -size / 2, size / 2)
            enter, leave = np.maximum(enter, low), np.minimum(leave, high)
        return np.asarray(np.maximum(enter, 0.0) < np.minimum(leave, 1.0))

    def nearest(self, xy_m: Floats) -> Floats:
        """Return `(*batch, 2)`: the points of its footprint nearest to `(*batch, 2)`."""
        half = np.array([self.length_m, self.width_m]) / 2 - self.overhang_m
        local = np.clip(self._local(xy_m), -half, half)
        return np.asarray(local @ _turned(self.yaw).T + (self.x_m, self.y_m))

    def _local(self, xy_m: Floats) -> Floats:
        return np.asarray((xy_m - (self.x_m, self.y_m)) @ _turned(self.yaw))


@cache
def _turned(yaw: float) -> Floats:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def _slab(start: Floats, along: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    """Return from which to which share of the way a line lies between two parallel planes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - start) / along, (high - start) / along
    level = along == 0
    between = (start > low) & (start < high)
    enter = np.where(level, np.where(between, -np.inf, np.inf), np.minimum(first, second))
    leave = np.where(level, np.where(between, np.inf, -np.inf), np.maximum(first, second))
    return enter, leave
