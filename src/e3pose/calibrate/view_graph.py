"""The graph of cameras with a known relative pose, chained along its strongest edges.

No camera has to see everything. The cameras are the nodes of a graph, a pair that saw something
together an edge; along a spanning tree of its strongest edges every camera of a connected part is
placed relative to one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.rotations import angles_between, nearest_rotation

AGREE_RAD = 0.1  # relative poses of one pair within this of the best are averaged
AGREE_SHARE = 0.2  # of the distance between the two cameras, likewise


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """The relative pose of a pair of cameras.

    Attributes:
        T_first_second: `(4, 4)` second camera to first.
        weight: how much it is to be trusted, such as how many times both saw the board.
    """

    T_first_second: Floats
    weight: float


def connected(num_cameras: int, edges: Mapping[tuple[int, int], Edge]) -> list[list[int]]:
    """Return the cameras by connected part, the largest part first, each rising."""
    part = list(range(num_cameras))
    for first, second in edges:
        old, new = part[second], part[first]
        part = [new if value == old else value for value in part]
    groups = [[c for c in range(num_cameras) if part[c] == value] for value in sorted(set(part))]
    return sorted(groups, key=lambda group: (-len(group), group))


def chain(num_cameras: int, edges: Mapping[tuple[int, int], Edge], root: int) -> Floats:
    """Return `(num_cameras, 4, 4)` camera to root camera; NaN where nothing leads there.

    Args:
        num_cameras: how many.
        edges: by pair of camera indices.
        root: the camera that becomes the origin.
    """
    placed: Floats = np.full((num_cameras, 4, 4), np.nan)
    placed[root] = np.eye(4)
    done = {root}
    while True:
        best: tuple[float, int, int] | None = None
        for (first, second), edge in edges.items():
            if (first in done) != (second in done):
                known, new = (first, second) if first in done else (second, first)
                if best is None or edge.weight > best[0]:
                    best = (edge.weight, known, new)
        if best is None:
            return placed
        _, known, new = best
        if (known, new) in edges:
            step = edges[known, new].T_first_second
        else:
            step = np.asarray(np.linalg.inv(edges[new, known].T_first_second))
        placed[new] = placed[known] @ step
        done.add(new)


def edges_from_boards(boards: Floats) -> dict[tuple[int, int], Edge]:
    """Relate every pair of cameras by the boards that both saw.

    Args:
        boards: `(num_cameras, num_times, 4, 4)` board to camera; NaN where not seen.
    """
    edges = {}
    for first in range(len(boards)):
        for second in range(first + 1, len(boards)):
            both = np.isfinite(boards[[first, second]]).all(axis=(0, 2, 3))
            if both.any():
                relative = boards[first, both] @ np.linalg.inv(boards[second, both])
                edges[first, second] = robust_mean(relative)
    return edges


def robust_mean(relative: Floats) -> Edge:
    """Return the mean of those `(n, 4, 4)` transforms that agree with the one most agree with."""
    number = len(relative)
    first, second = np.repeat(np.arange(number), number), np.tile(np.arange(number), number)
    rotations, shifts = relative[:, :3, :3], relative[:, :3, 3]
    turn = angles_between(rotations[first], rotations[second]).reshape(number, number)
    apart = np.linalg.norm(shifts[:, None] - shifts[None], axis=-1)
    limit = AGREE_SHARE * np.linalg.norm(shifts, axis=1) + 0.01
    agree = (turn < AGREE_RAD) & (apart < limit[:, None])
    best = int(np.argmax(agree.sum(axis=1)))
    mean = np.eye(4)
    mean[:3, :3] = nearest_rotation(rotations[agree[best]].mean(axis=0))
    mean[:3, 3] = np.median(shifts[agree[best]], axis=0)
    return Edge(mean, float(agree[best].sum()))
