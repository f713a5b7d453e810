"""Extrinsics from a board that pairs of cameras see at the same time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.calibrate.bundle import Adjusted, AdjustOptions, adjust_boards, placed, root_mean_square
from e3pose.calibrate.intrinsics import resect
from e3pose.calibrate.view_graph import chain, connected, edges_from_boards
from e3pose.errors import InputError
from e3pose.geometry.camera import Rig

Floats = NDArray[np.float64]

MIN_TIMES = 3  # in which a pair must have seen the board together
OUTLIER_SIGMAS = 3.0
FIRST_SIGMA_PX = 0.5  # of a corner; measured from the residuals afterwards
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
        InputError: when no camera saw enough of it.
    """
    counts = np.isfinite(corners_px[..., 0]).sum(axis=1)
    best = int(np.argmax(counts))
    start, _ = resect(rig.cameras[best], corners_m, corners_px[best : best + 1])
    if not np.isfinite(start).all():
        raise InputError("--floor: found no board in the pictures; does --board match it?")
    held = np.zeros(len(rig), dtype=bool)
    adjusted = adjust_boards(
        rig,
        start,
        corners_m,
        corners_px[:, None],
        FIRST_SIGMA_PX,
        AdjustOptions(OUTLIER_SIGMAS, held),
    )
    return np.asarray(adjusted.blocks[0])


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
