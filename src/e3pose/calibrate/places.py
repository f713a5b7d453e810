"""Extrinsics of a rig from films of a board, a ball or a wand, or from points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.align import Move, guess
from e3pose.calibrate.ball import track_balls
from e3pose.calibrate.board import Board
from e3pose.calibrate.board_views import find_board
from e3pose.calibrate.bundle import root_mean_square
from e3pose.calibrate.from_boards import check_connected, solve_boards
from e3pose.calibrate.from_points import MIN_SHARED, PointRig, pair_poses, solve_points
from e3pose.calibrate.lenses import expected_lenses
from e3pose.calibrate.people_3d import Scale, from_distance
from e3pose.calibrate.uncertainty import CameraErrors
from e3pose.calibrate.wand import Wand, adjust_wand
from e3pose.camera.source import open_video
from e3pose.model.camera import Rig

Fit = tuple[Floats, Floats, NDArray[np.int64], NDArray[np.int64]]

BALL_SIGMA_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """A rig that was solved, and how well.

    Attributes:
        rig: the cameras, in metres.
        source: board, ball, wand, points or people.
        errors_px: `(num_cameras,)` root mean square reprojection error of what agrees.
        outliers: `(num_cameras,)` share of what was seen that does not agree; NaN if nothing was.
        observations: `(num_cameras,)` how many points were used.
        together: `(num_cameras, num_cameras)` how many of them two cameras share.
        scale: metres and where they are from; None where a board states them.
        world: where the axes are from, in words.
        notes: what to look at or do next, in words.
        expected: errors that the cameras are expected to have; None where that is not known.
    """

    rig: Rig
    source: str
    errors_px: Floats
    outliers: Floats
    observations: NDArray[np.int64]
    together: NDArray[np.int64]
    scale: Scale | None
    world: str
    notes: list[str]
    expected: CameraErrors | None = None


@dataclass(frozen=True, slots=True)
class KnownLength:
    """A length that fixes the scale; one of its fields at most is set.

    Attributes:
        height_m: how tall the people are.
        distance: two camera ids and metres.
        limb: two joints and metres.
    """

    height_m: float | None = None
    distance: tuple[str, str, float] | None = None
    limb: tuple[str, str, float] | None = None


def common_times(paths: Mapping[str, Path], offsets_s: Mapping[str, float], rate: float) -> Floats:
    """Return `(num_times,)` seconds on the common clock during which at least two videos run.

    Raises:
        InputError: when no two videos overlap in time.
    """
    ends = []
    for camera_id, path in paths.items():
        source = open_video(path)
        begin = offsets_s.get(camera_id, 0.0)
        ends.append((begin, begin + (source.num_frames - 1) / source.rate))
    begin, end = sorted(b for b, _ in ends)[1], sorted(e for _, e in ends)[-2]
    if end <= begin:
        raise InputError("videos: never run at the same time, expected films of one scene")
    return np.asarray(np.arange(begin, end + 1e-9, 1 / rate))


def from_board_films(
    paths: Mapping[str, Path],
    lenses: Rig,
    board: Board,
    offsets_s: Mapping[str, float],
    rate: float,
    progress_of: Callable[[str], Callable[[int, int], None]],
) -> Places:
    """Place cameras by films of a board that was carried about between them.

    Args:
        paths: film, or folder of pictures taken together, by camera id.
        lenses: intrinsics of those cameras, in the same order.
        board: the board.
        offsets_s: when each film began, on the common clock.
        rate: how many times a second to look.
        progress_of: returns, for a camera, what takes frames done and in all.
    """
    board.check_oriented()
    folders = any(path.is_dir() for path in paths.values())
    times = None if folders else common_times(paths, offsets_s, rate)
    found = {}
    for camera_id, path in paths.items():
        own = None if times is None else times - offsets_s.get(camera_id, 0.0)
        views = find_board(camera_id, path, board, own, progress=progress_of(camera_id))
        check_size(lenses, camera_id, views.image_size)
        found[camera_id] = views
    every = (
        np.unique(np.concatenate([views.times_s for views in found.values()]))
        if times is None
        else times
    )
    corners = np.full((len(lenses), len(every), len(board.corners_m), 2), np.nan)
    for index, camera_id in enumerate(lenses.camera_ids):
        views = found[camera_id]
        shift = 0.0 if times is None else offsets_s.get(camera_id, 0.0)
        place = np.searchsorted(every, views.times_s + shift - 1e-6)
        corners[index, place] = views.corners_px
    solved = solve_boards(lenses, board.corners_m, corners)
    rig = guess(solved.adjusted.rig).rig(solved.adjusted.rig)
    weights = solved.adjusted.weights
    seen = weights > 0
    notes = ["the vertical is guessed from level cameras and the floor from their height: "
             "e3pose calibrate align puts both right"]  # fmt: skip
    if float(np.nanmedian(solved.errors_px)) > 1.5:
        notes.insert(0, "errors above 1.5 px: hold the board still for a second at each place, or "
                        "find the films' offsets first (e3pose sync)")  # fmt: skip
    return Places(
        rig, "board", solved.errors_px, _outliers(weights, seen), seen.sum(axis=(1, 2)),
        solved.together, None, "guessed from level cameras", notes,
    )  # fmt: skip


def from_ball_films(
    paths: Mapping[str, Path],
    lenses: Rig,
    carried: str | Wand,
    offsets_s: Mapping[str, float],
    rate: float,
    known: KnownLength,
) -> Places:
    """Place cameras by films of one ball or a wand of balls.

    Args:
        paths: film by camera id.
        lenses: intrinsics of those cameras, in the same order.
        carried: the ball's colour, or a wand whose markers are colours.
        offsets_s: when each film began, on the common clock.
        rate: how many times a second to look.
        known: the distance of two cameras; with a wand, nothing.
    """
    times = common_times(paths, offsets_s, rate)
    colours = carried.markers if isinstance(carried, Wand) else (carried,)
    points = np.full((len(lenses), len(times), len(colours), 2), np.nan)
    for index, (camera_id, path) in enumerate(paths.items()):
        points[index], size = track_balls(path, times - offsets_s.get(camera_id, 0.0), colours)
        check_size(lenses, camera_id, size)
    if isinstance(carried, Wand):
        return from_wand_seen(lenses, carried, points)
    return from_points_seen(lenses, points[:, :, 0], known, "ball")


def from_points_seen(
    lenses: Rig, keypoints_px: Floats, known: KnownLength, source: str = "points"
) -> Places:
    """Place cameras by points of which it is known which is which.

    Args:
        lenses: intrinsics.
        keypoints_px: `(num_cameras, num_points, 2)` pixels; NaN where not seen.
        known: the distance of two cameras.
        source: for the report.

    Raises:
        InputError: without a known distance, or when no rig explains the points.
    """
    if known.distance is None:
        raise InputError(
            "scale: unknown from points alone, expected --distance CAM1,CAM2=METRES, as measured "
            "between two lenses, or a wand (--wand)"
        )
    adjusted = _by_points(lenses, keypoints_px, source).adjusted
    scale = from_distance(adjusted.rig, *known.distance)
    rig = Move(scale.factor, np.eye(3), np.zeros(3)).rig(adjusted.rig)
    return _guessed(
        rig, source, agreement(adjusted.residuals, adjusted.weights, BALL_SIGMA_PX), scale
    )


def from_wand_seen(lenses: Rig, wand: Wand, keypoints_px: Floats) -> Places:
    """Place cameras by a wand that was carried about.

    Args:
        lenses: intrinsics.
        wand: its markers.
        keypoints_px: `(num_cameras, num_times, num_markers, 2)` pixels; NaN where not seen.
    """
    found = _by_points(lenses, keypoints_px.reshape(len(lenses), -1, 2), "wand")
    solved = adjust_wand(
        found.adjusted.rig, wand, keypoints_px, BALL_SIGMA_PX, expected_lenses(lenses)
    )
    adjusted, flat = solved.adjusted, (len(lenses), -1, 1)
    fit = agreement(
        adjusted.residuals.reshape(*flat, 2), adjusted.weights.reshape(flat), BALL_SIGMA_PX
    )
    source = f"a wand of {1000 * wand.length_m:g} mm, placed {1000 * solved.off_m:.1f} mm from that"
    return _guessed(adjusted.rig, "wand", fit, Scale(1.0, source, solved.share))


def _by_points(lenses: Rig, keypoints_px: Floats, source: str) -> PointRig:
    """Place cameras in whatever unit, or raise which could not be."""
    sigma = np.full(keypoints_px.shape[:2], BALL_SIGMA_PX)
    poses = pair_poses(lenses, keypoints_px, sigma)
    solved = solve_points(lenses, keypoints_px, sigma, poses, expected_lenses(lenses))
    if solved is None:
        raise InputError(
            f"points: no two cameras agree, expected one {source} that moves through all the room "
            "in films that begin together"
        )
    seen = np.isfinite(keypoints_px[..., 0])
    shared = (seen & seen[solved.placed].any(axis=0)).sum(axis=1)
    for index in np.flatnonzero(~solved.placed & (shared >= MIN_SHARED)).tolist():
        raise InputError(
            f"camera {lenses.camera_ids[index]}: shares {shared[index]} points with others, but "
            "they fit no place of it: its film began at another time (--offset), it was moved, or "
            "--intrinsics has another lens"
        )
    parts = [
        np.flatnonzero(solved.placed).tolist(),
        *([i] for i in np.flatnonzero(~solved.placed).tolist()),
    ]
    check_connected(lenses.camera_ids, parts, f"see the {source}")
    return solved


def _guessed(rig: Rig, source: str, fit: Fit, scale: Scale) -> Places:
    """Return places whose axes are guessed, as nothing that was seen tells them."""
    return Places(
        guess(rig).rig(rig), source, *fit, scale, "guessed from level cameras",
        ["the vertical and the floor are guessed: e3pose calibrate align puts both right"],
    )  # fmt: skip


def check_size(lenses: Rig, camera_id: str, size: tuple[int, int]) -> None:
    """Raise `InputError` unless pictures are as large as those the lens was measured in."""
    expected = lenses.cameras[lenses.index(camera_id)].image_size
    if size not in (expected, (0, 0)):
        raise InputError(
            f"camera {camera_id}: image size: found {size[0]}x{size[1]}, expected "
            f"{expected[0]}x{expected[1]} as in --intrinsics; measure the lens in this mode"
        )


def agreement(residuals: Floats, weights: Floats, sigma_px: Floats | float) -> Fit:
    """Return errors, outliers, counts and shared counts of points, as `Places` has them."""
    weights = weights[..., 0]
    seen = weights > 0
    length = np.linalg.norm(residuals[..., 0, :], axis=-1) * sigma_px
    agree = weights > 0.4
    errors = root_mean_square(np.where(agree, length, np.nan), axis=1)
    together = (seen[:, None] & seen[None]).sum(axis=-1)
    return errors, _outliers(weights, seen), seen.sum(axis=1), together


def _outliers(weights: Floats, seen: NDArray[np.bool_]) -> Floats:
    axes = tuple(range(1, weights.ndim))
    count = seen.sum(axis=axes)
    bad = (seen & (weights <= 0.4)).sum(axis=axes)
    return np.where(count > 0, bad / np.maximum(count, 1), np.nan)
