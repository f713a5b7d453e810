"""Extrinsics from a board that pairs of cameras see at the same time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.bundle import Adjusted, AdjustOptions, adjust_boards, root_mean_square
from e3pose.calibrate.intrinsics import resect
from e3pose.calibrate.moved_cameras import placed
from e3pose.model.camera import Camera, Rig
from e3pose.model.rotations import angles_between, nearest_rotation

# The graph of cameras with a known relative pose, chained along its strongest edges.
#
# No camera has to see everything. The cameras are the nodes of a graph, a pair that saw something
# together an edge; along a spanning tree of its strongest edges every camera of a connected part
# is placed relative to one of them.

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
    """Return the mean of `(n, 4, 4)` transforms that agree with the one most agree with."""
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


MIN_TIMES = 3  # in which a pair must have seen the board together
OUTLIER_SIGMAS = 3.0
FIRST_SIGMA_PX = 0.5  # of a corner; measured from the residuals afterwards
# A board on the floor that is turned by more is another solution. It is ruled out by so much more
# of the sum of squares, and so many times as much: lenses err as well.
ANOTHER_RAD = np.radians(5.0)
LEAST_COST, LEAST_TIMES = 30.0, 1.1
WILD_PX = 8.0  # a board that errs more than this in a view was misread, or moved


@dataclass(frozen=True, slots=True, eq=False)
class BoardRig:
    """A rig solved from boards.

    Attributes:
        adjusted: cameras, boards and residuals, in standard deviations of `sigma_px`.
        sigma_px: standard deviation of a corner, as found.
        errors_px: `(num_cameras,)` root mean square reprojection error.
        together: `(num_cameras, num_cameras)` times at which both saw the board.
        times: `(num_boards,)` which of the times given the boards are of.
    """

    adjusted: Adjusted
    sigma_px: float
    errors_px: Floats
    together: NDArray[np.int64]
    times: NDArray[np.int64]


def solve_boards(rig: Rig, corners_m: Floats, corners_px: Floats) -> BoardRig:
    """Place cameras by a board; the first camera becomes the origin of the world.

    Args:
        rig: lenses; extrinsics are not looked at.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_cameras, num_times, num_corners, 2)` pixels; NaN where not found.

    Raises:
        InputError: naming the cameras that saw no board together with the others.
    """
    home = Rig(tuple(placed(camera, np.eye(3), np.zeros(3)) for camera in rig.cameras))
    boards = np.full((*corners_px.shape[:2], 4, 4), np.nan)
    for index, camera in enumerate(home.cameras):
        found, errors = resect(camera, corners_m, corners_px[index])
        size = root_mean_square(errors, axis=(1, 2))
        boards[index] = np.where((size < WILD_PX)[:, None, None], found, np.nan)
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(boards).all(axis=(2, 3)))
    together = (seen[:, None] & seen[None]).sum(axis=-1)
    edges = {
        pair: edge for pair, edge in edges_from_boards(boards).items() if edge.weight >= MIN_TIMES
    }
    check_connected(rig.camera_ids, connected(len(rig), edges), "saw the board at the same time")
    places = chain(len(rig), edges, 0)
    start = Rig(
        tuple(
            placed(camera, place[:3, :3].T, -place[:3, :3].T @ place[:3, 3])
            for camera, place in zip(rig.cameras, places, strict=True)
        )
    )
    times = np.flatnonzero(seen.sum(axis=0) >= 2)
    counts = np.where(seen, np.isfinite(corners_px[..., 0]).sum(axis=-1), 0)
    best = counts[:, times].argmax(axis=0)
    in_world = places[best] @ boards[best, times]
    used_px = np.where(seen[:, times, None, None], corners_px[:, times], np.nan)
    sigma_px = FIRST_SIGMA_PX
    for _ in range(2):  # the second time with the noise that the first found
        adjusted = adjust_boards(
            start, in_world, corners_m, used_px, sigma_px, AdjustOptions(OUTLIER_SIGMAS)
        )
        start, in_world = adjusted.rig, adjusted.blocks
        spread = float(np.nanmedian(np.abs(adjusted.residuals))) * 1.4826
        sigma_px *= max(spread, 1e-3)
    errors_px = root_mean_square(np.linalg.norm(adjusted.residuals, axis=-1), axis=(1, 2))
    scale = sigma_px / max(spread, 1e-3)
    return BoardRig(adjusted, sigma_px, errors_px * scale, together, times)


def board_on_floor(rig: Rig, corners_m: Floats, corners_px: Floats) -> Floats:
    """Place one board that lies still, seen by one or more cameras that are placed.

    Args:
        rig: the cameras.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_cameras, num_corners, 2)` pixels; NaN where not found.

    Returns:
        `(4, 4)` board to world.

    Raises:
        InputError: when no camera saw enough of it, or it may as well be tilted the other way.
    """
    starts = [
        place
        for camera, seen_px in zip(rig.cameras, corners_px, strict=True)
        for place in both_places(camera, corners_m, seen_px)
    ]
    if not starts:
        raise InputError("--floor: found no board in the pictures; does --board match it?")
    held = AdjustOptions(OUTLIER_SIGMAS, np.zeros(len(rig), dtype=bool))
    found = [
        adjust_boards(rig, start[None], corners_m, corners_px[:, None], FIRST_SIGMA_PX, held)
        for start in starts
    ]
    spread = min(float(np.nanmedian(np.abs(each.residuals))) for each in found) * 1.4826
    costs = np.array([_cost(each.residuals / max(spread, 1e-3)) for each in found])
    seen = [np.isfinite(each.residuals).all(axis=-1).sum() for each in found]
    shown = _shown(rig, corners_px, np.array([each.blocks[0] for each in found]))
    costs[(np.array(seen) < max(seen)) | ~shown] = np.inf  # behind a camera, or seen from behind
    if not np.isfinite(costs).any():
        raise InputError("--floor: found no place of the board that fits the pictures")
    best = int(costs.argmin())
    board = np.asarray(found[best].blocks[0])
    others = [
        cost
        for each, cost in zip(found, costs.tolist(), strict=True)
        if each.blocks[0, :3, 2] @ board[:3, 2] < np.cos(ANOTHER_RAD)
    ]
    if others and min(others) < max(costs[best] + LEAST_COST, LEAST_TIMES * costs[best]):
        raise InputError(
            "--floor",
            "a board that is as likely tilted the other way: it is seen too small, or too flat",
            "a larger board, pictures by more cameras, or a place nearer to them; --points and a "
            "recording of people also tell the floor",
        )
    return board


def both_places(camera: Camera, corners_m: Floats, corners_px: Floats) -> list[Floats]:
    """Return the places of a board that one view allows: a flat thing far away has two.

    Args:
        camera: which is placed.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_corners, 2)` pixels; NaN where not found.

    Returns:
        `(4, 4)` each, board to world (IPPE, Collins and Bartoli 2014), and its mirrored one, where
        noise hides one of them; none without four corners.
    """
    import cv2

    ideal = camera.normalise(corners_px)
    seen = np.isfinite(ideal).all(axis=-1)
    if seen.sum() < 4:
        return []
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            corners_m[seen], ideal[seen][:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    places = []
    for turn, shift in zip(turns, shifts, strict=True):
        if np.isfinite(turn).all() and shift[2, 0] > 0:
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
            places += [
                camera.T_world_camera @ each for each in (place, _mirrored(place, corners_m))
            ]
    return places


def _mirrored(place: Floats, corners_m: Floats) -> Floats:
    """Return the place `(4, 4)` of a board that is tilted the other way for its camera."""
    middle = place[:3, :3] @ corners_m.mean(axis=0) + place[:3, 3]
    line = middle / np.linalg.norm(middle)
    half = 2 * np.outer(line, line) - np.eye(3)  # half a turn about the line of sight
    normal = half @ place[:3, 2]
    other = np.eye(4)
    other[:3, :3] = (2 * np.outer(normal, normal) - np.eye(3)) @ half @ place[:3, :3]
    other[:3, 3] = middle - other[:3, :3] @ corners_m.mean(axis=0)
    return other


def _shown(rig: Rig, corners_px: Floats, places: Floats) -> NDArray[np.bool_]:
    """Return which places `(num_places, 4, 4)` show the front to all cameras that saw the board."""
    saw = np.isfinite(corners_px).all(axis=-1).any(axis=-1)
    away = places[:, None, :3, 3] - rig.centers_m[saw]
    return np.asarray(((away * places[:, None, :3, 2]).sum(axis=-1) > 0).all(axis=1))


def _cost(residuals: Floats) -> float:
    """Return the robust sum of squares of residuals, in standard deviations; NaN is not seen."""
    squares = np.nansum(residuals**2, axis=-1)
    return float((OUTLIER_SIGMAS**2 * np.log1p(squares / OUTLIER_SIGMAS**2)).sum())


def check_connected(camera_ids: tuple[str, ...], parts: list[list[int]], what: str) -> None:
    """Raise `InputError` that names the cameras outside the largest connected part."""
    if len(parts) == 1:
        return
    largest = ", ".join(camera_ids[i] for i in parts[0])
    others = "; ".join(", ".join(camera_ids[i] for i in part) for part in parts[1:])
    raise InputError(
        f"cameras: {others}: never {what} as {largest}, expected every camera to share views with "
        "another; record more where their views overlap, or leave them out"
    )
