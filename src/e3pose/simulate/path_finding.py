"""Shortest paths around walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.simulate.occluders import Occluder

CLEARANCE_M = 0.3  # a body's half width and a little
STEP_M = 0.1
ENDS_M = 0.35  # people may start and stop nearer to a wall than they walk along it


class Ways:
    """The shortest paths of a scene along its corners and doors.

    Args:
        corners: `(num_corners, 2)` metres, where people turn; none for straight lines everywhere.
        things: what stands in the way.
    """

    def __init__(self, corners: Floats, things: Sequence[Occluder]) -> None:
        self.corners = corners
        self.things = things
        number = len(corners)
        self.lengths = np.full((number, number), np.inf)
        for first in range(number):
            for second in range(first, number):
                if self.clear(corners[first], corners[second]):
                    length = float(np.hypot(*(corners[first] - corners[second])))
                    self.lengths[first, second] = self.lengths[second, first] = length
        # Floyd and Warshall; `onward[a, b]` is where to turn next on the way from a to b.
        self.onward = np.tile(np.arange(number), (number, 1))
        for middle in range(number):
            around = self.lengths[:, middle, None] + self.lengths[None, middle]
            shorter = around < self.lengths - 1e-9
            self.lengths = np.where(shorter, around, self.lengths)
            self.onward = np.where(shorter, self.onward[:, middle, None], self.onward)

    def clear(self, start: Floats, end: Floats) -> bool:
        """Return whether somebody can walk straight from `(2,)` to `(2,)` metres."""
        length = float(np.hypot(*(end - start)))
        along = np.arange(min(ENDS_M, length / 2), max(length - ENDS_M, length / 2) + 1e-9, STEP_M)
        points = start + np.outer(along / max(length, 1e-9), end - start)
        return all(
            bool((np.linalg.norm(thing.nearest(points) - points, axis=1) >= CLEARANCE_M).all())
            for thing in self.things
        )

    def route(self, start: Floats, goal: Floats) -> list[Floats]:
        """Return the points `(2,)` to head for one after another; the last is the goal.

        Without corners, or where no way is known, it is the goal alone.
        """
        if len(self.corners) == 0 or self.clear(start, goal):
            return [goal]
        near = [i for i, corner in enumerate(self.corners) if self.clear(start, corner)]
        far = [i for i, corner in enumerate(self.corners) if self.clear(corner, goal)]
        lengths = {
            (first, last): float(
                np.hypot(*(self.corners[first] - start))
                + self.lengths[first, last]
                + np.hypot(*(goal - self.corners[last]))
            )
            for first in near
            for last in far
        }
        if not lengths or min(lengths.values()) == np.inf:
            return [goal]
        here, last = min(lengths, key=lambda pair: lengths[pair])
        points = [self.corners[here]]
        while here != last:
            here = int(self.onward[here, last])
            points.append(self.corners[here])
        return [*points, goal]
