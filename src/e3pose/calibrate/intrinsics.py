"""Intrinsics of one camera from views of a board: Zhang's method, with a choice of lens model.

Z. Zhang, "A flexible new technique for camera calibration" (2000); the fisheye model is that of
Kannala and Brandt (2006), as OpenCV has it. Every model is fitted without some of the views and
judged by its reprojection error in those; the simplest that is about as good as the best is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.calibrate.board_views import BoardViews
from e3pose.calibrate.bundle import AdjustOptions, adjust_boards
from e3pose.model.camera import Camera, Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes


BLURRED = 0.6  # a view less sharp than this share of the median is left out while others are there
GRID = (4, 3)  # parts of the picture, across and down, in which corners are asked for
TILTS = 0.05  # log of the ratio of opposite sides from which a board counts as tilted
TILT_SCALE = 1.5  # of a tilt beside places and sizes, when views are told apart
ENOUGH_VIEWS = 15
SMALL = 0.25  # a board this share of the picture's width is small


def choose_views(
    corners_m: Floats,
    corners_px: Floats,
    image_size: tuple[int, int],
    sharpness: Floats,
    max_views: int,
) -> NDArray[np.int64]:
    """Return which views to use, rising.

    Views are taken farthest first: each is the one least like those taken, by place in the picture,
    size and tilt, so that a minute of holding still in the middle counts once.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)`; NaN where not found.
        image_size: `(width, height)` in pixels.
        sharpness: `(num_views,)` larger is sharper.
        max_views: how many at most.
    """
    features = view_features(corners_m, corners_px, image_size)
    good = np.isfinite(features).all(axis=1)
    sharp = good & (sharpness >= BLURRED * np.median(sharpness))
    candidates = np.flatnonzero(sharp if sharp.sum() >= max_views // 2 else good)
    if len(candidates) <= max_views:
        return np.asarray(candidates, dtype=np.int64)
    seen = np.isfinite(corners_px[candidates, :, 0]).sum(axis=1)
    chosen = [int(np.argmax(seen * sharpness[candidates]))]
    distance = np.full(len(candidates), np.inf)
    while len(chosen) < max_views:
        newest = features[candidates[chosen[-1]]]
        distance = np.minimum(distance, np.linalg.norm(features[candidates] - newest, axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.asarray(np.sort(candidates[chosen]), dtype=np.int64)


def view_features(corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]) -> Floats:
    """Return `(num_views, 5)`: centre x and y, size, and two tilts, each of the order of one."""
    low, high = corners_m[:, :2].min(axis=0), corners_m[:, :2].max(axis=0)
    outline = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    features = np.full((len(corners_px), 5), np.nan)
    for index, view in enumerate(corners_px):
        seen = np.isfinite(view[:, 0])
        H = homography(corners_m[seen, :2], view[seen])
        homogeneous = np.column_stack([outline, np.ones(4)]) @ H.T
        if not np.isfinite(H).all() or not (homogeneous[:, 2] > 1e-9).all():
            continue
        quad = homogeneous[:, :2] / homogeneous[:, 2:]
        sides = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1)
        middle = view[seen].mean(axis=0) / np.array(image_size)
        size = float(np.sqrt(sides.max() * sides.min()) / max(image_size))
        tilts = np.log(sides[[0, 1]] / sides[[2, 3]])
        features[index] = [*middle, size, *np.clip(TILT_SCALE * tilts, -1, 1)]
    return features


def tilted_views(
    corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return `(num_views, 2)` whether the board is tilted, forwards and to the side.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)`; NaN where not found.
        image_size: `(width, height)` in pixels.
    """
    tilts = view_features(corners_m, corners_px, image_size)[:, 3:]
    return np.asarray(np.abs(tilts) > TILT_SCALE * TILTS)


def homography(source: Floats, target: Floats) -> Floats:
    """Return `(3, 3)` H with `target ~ H source` for `(n, 2)` points (Hartley-Zisserman 4.1)."""
    if len(source) < 4:
        return np.full((3, 3), np.nan)
    mean, spread = target.mean(axis=0), float(target.std()) or 1.0
    origin, width = source.mean(axis=0), float(source.std()) or 1.0
    x, y = ((source - origin) / width).T
    u, v = ((target - mean) / spread).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows_u = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=-1)
    rows_v = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=-1)
    H = np.linalg.svd(np.concatenate([rows_u, rows_v]))[2][-1].reshape(3, 3)
    into = np.array(
        [[1 / width, 0, -origin[0] / width], [0, 1 / width, -origin[1] / width], [0, 0, 1]]
    )
    back = np.array([[spread, 0, mean[0]], [0, spread, mean[1]], [0, 0, 1]])
    H = back @ H @ into
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(H / H[2, 2])


def covered(corners_px: Floats, image_size: tuple[int, int]) -> NDArray[np.int64]:
    """Return `(3, 4)` counts of corners by part of the picture, top row first."""
    seen = corners_px[np.isfinite(corners_px[..., 0])]
    x = np.clip(seen[:, 0] / image_size[0] * GRID[0], 0, GRID[0] - 1).astype(int)
    y = np.clip(seen[:, 1] / image_size[1] * GRID[1], 0, GRID[1] - 1).astype(int)
    counts = np.zeros((GRID[1], GRID[0]), dtype=np.int64)
    np.add.at(counts, (y, x), 1)
    return counts


def advice(corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]) -> list[str]:
    """Return advice on further recordings for a better calibration, as sentences.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)` pixels; NaN where not seen.
        image_size: `(width, height)` pixels.
    """
    words = []
    if len(corners_px) < ENOUGH_VIEWS:
        words.append(f"record longer: {len(corners_px)} usable views, {ENOUGH_VIEWS} or more help")
    counts = covered(corners_px, image_size)
    rows, columns = ("top", "middle", "bottom"), ("left", "middle", "middle", "right")
    empty = {
        f"{rows[y]} {columns[x]}".replace("middle middle", "middle")
        for y, x in np.argwhere(counts < 4).tolist()
    }
    if empty:
        places = [f"{r} {c}" for r in rows for c in ("left", "middle", "right")]
        named = [p.replace("middle middle", "middle") for p in places]
        words.append("hold the board to the " + ", ".join(p for p in named if p in empty))
    features = view_features(corners_m, corners_px, image_size)
    features = features[np.isfinite(features).all(axis=1)]
    if len(features):
        tilted = tilted_views(corners_m, corners_px, image_size)
        for axis, how in ((0, "forwards and backwards"), (1, "to the left and to the right")):
            if tilted[:, axis].sum() < 4:
                words.append(f"tilt the board {how} by 20 to 40 degrees")
        if np.quantile(features[:, 2], 0.8) < SMALL:
            words.append("hold the board nearer: it should fill a third of the picture or more")
    return words


MODELS = ("pinhole", "pinhole-k3", "fisheye")  # simplest first
MIN_VIEW_CORNERS = 6
MIN_VIEWS = 5  # two would do for a lens without error; fewer than this are refused
MOST_VIEWS = 60
FOLDS = 3
WORTH = 0.97  # a richer model must lower the held-out error to this share
OUTLIER_VIEW = 3.0  # a view this many times worse than the median is left out
OUTLIER_CORNER, LEAST_PX = 5.0, 0.5  # times the median error, and pixels, beyond which a corner is
CLEANINGS = 6  # fits, each without the corners that the one before does not explain
MIN_TILTED = 3  # views: a board that is held parallel leaves the focal length open
FILMED_CORNERS = 10  # beyond the angle up to which a fisheye lens counts as measured
CORNER_SIGMAS = 3.0  # of a corner's error, where its weight is halved


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """The lens of one camera, from views of a board.

    Attributes:
        camera: the camera, standing at the world's origin.
        model: one of `MODELS`.
        held_out_px: root mean square error in views that were left out of the fit, by model; NaN
            where a model could not be fitted.
        fit_px: the same in the views of the fit.
        focal_sigma: standard deviation of the focal length as a share of it.
        used: `(num_used,)` which of the views given were used.
        errors_px: `(num_used, num_corners)` lengths of the errors; NaN where not found, or where
            the corner was left out.
    """

    camera: Camera
    model: str
    held_out_px: dict[str, float]
    fit_px: float
    focal_sigma: float
    used: NDArray[np.int64]
    errors_px: Floats


def fit_intrinsics(
    camera_id: str,
    image_size: tuple[int, int],
    corners_m: Floats,
    corners_px: Floats,
    sharpness: Floats,
    models: tuple[str, ...] = MODELS,
) -> Intrinsics:
    """Fit focal length, principal point and lens.

    Args:
        camera_id: for the camera and for messages.
        image_size: `(width, height)` in pixels.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)` pixels; NaN where a corner was not found.
        sharpness: `(num_views,)` larger is sharper.
        models: to choose from.

    Raises:
        InputError: when there are too few views, or no model fits them.
    """
    if len(corners_px) < MIN_VIEWS:
        raise InputError(
            f"camera {camera_id}: found the board in {len(corners_px)} frames, expected at least "
            f"{MIN_VIEWS}; is --board the one that was filmed, is all of it in the picture, and "
            "has it a white rim?"
        )
    used = choose_views(corners_m, corners_px, image_size, sharpness, MOST_VIEWS)
    tilted = int(tilted_views(corners_m, corners_px[used], image_size).any(axis=1).sum())
    if tilted < MIN_TILTED:
        raise InputError(
            f"camera {camera_id}: found {tilted} views of a tilted board, expected at least "
            f"{MIN_TILTED}: a board held parallel to the image does not tell the focal length; "
            "record it again, tilted by 20 to 40 degrees to all sides"
        )
    used, cleaned = _without_outliers(image_size, corners_m, corners_px, used)
    held_out = {model: _held_out(model, image_size, corners_m, cleaned) for model in models}
    best = min((value for value in held_out.values() if np.isfinite(value)), default=np.nan)
    if np.isnan(best):
        raise InputError(
            f"camera {camera_id}: no lens model fits the {len(used)} views of the board; record "
            "it again, tilted by 20 to 40 degrees to all sides, in all parts of the picture"
        )
    model = next(m for m in models if WORTH * held_out[m] <= best)
    camera = _fitted(camera_id, model, image_size, corners_m, cleaned)
    _, errors = resect(camera, corners_m, cleaned)
    if camera.fisheye:
        # Up to this angle off the axis corners were seen.
        seen = camera.normalise(cleaned[np.isfinite(cleaned[..., 0])])
        angles = np.sort(np.arctan(np.hypot(*seen.T)))
        filmed_angle = float(angles[np.isfinite(angles)][-FILMED_CORNERS:][0])
        camera = replace(camera, known_to=filmed_angle)
    lengths = np.linalg.norm(errors, axis=-1)
    fit_px = float(np.sqrt(np.nanmean(lengths**2)))
    return Intrinsics(
        camera, model, held_out, fit_px, _focal_sigma(camera, corners_m, cleaned, fit_px),
        used, lengths,
    )  # fmt: skip


def resect(camera: Camera, corners_m: Floats, corners_px: Floats) -> tuple[Floats, Floats]:
    """Place boards in front of a camera of known lens.

    Args:
        camera: whose extrinsics count as well.
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)` pixels; NaN where not found.

    Returns:
        `(num_views, 4, 4)` board-to-world transforms, NaN where none was found, and
        `(num_views, num_corners, 2)` errors in pixels.
    """
    boards = np.stack([_place_roughly(camera, corners_m, view) for view in corners_px])
    good = np.isfinite(boards).all(axis=(1, 2))
    errors = np.full(corners_px.shape, np.nan)
    if good.any():
        result = adjust_boards(
            Rig((camera,)),
            boards[good],
            corners_m,
            corners_px[None, good],
            1.0,
            AdjustOptions(CORNER_SIGMAS),
        )
        boards[good] = result.blocks
        errors[good] = result.residuals[0]
    return boards, errors


def _place_roughly(camera: Camera, corners_m: Floats, corners_px: Floats) -> Floats:
    import cv2

    ideal = camera.normalise(corners_px)
    seen = np.isfinite(ideal).all(axis=-1)
    placed = np.full((4, 4), np.nan)
    if seen.sum() < 4:
        return placed
    try:
        done, turn, shift = cv2.solvePnP(
            corners_m[seen], ideal[seen][:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return placed
    if not done or not np.isfinite(turn).all() or shift[2, 0] <= 0:
        return placed
    board = np.eye(4)
    board[:3, :3], board[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return np.asarray(camera.T_world_camera @ board)


def _fit(
    model: str, image_size: tuple[int, int], corners_m: Floats, corners_px: Floats
) -> tuple[Floats, Floats]:
    """Return `(3, 3)` K and the coefficients; raise `ValueError` when there is no fit."""
    import cv2

    objects, images = [], []
    for view in corners_px:
        seen = np.isfinite(view[:, 0])
        # One row each: OpenCV 5's fisheye model refuses columns of different lengths.
        objects.append(corners_m[seen][None].astype(np.float32))
        images.append(view[seen][None].astype(np.float32))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-8)
    try:
        if model == "fisheye":
            K, distortion = _fit_fisheye(image_size, objects, images, criteria)
        else:
            flags = 0 if model == "pinhole-k3" else cv2.CALIB_FIX_K3
            _, K, distortion, *_ = cv2.calibrateCamera(
                objects, images, image_size, None, None, flags=flags, criteria=criteria
            )
            distortion = distortion.reshape(-1)[: 5 if model == "pinhole-k3" else 4]
    except cv2.error as error:
        raise ValueError(str(error)) from None
    K = np.asarray(K, dtype=np.float64)
    K[0, 1] = 0.0
    return K, np.asarray(distortion, dtype=np.float64).reshape(-1)


def _fit_fisheye(
    image_size: tuple[int, int],
    objects: list[NDArray[np.float32]],
    images: list[NDArray[np.float32]],
    criteria: tuple[int, int, float],
) -> tuple[Any, Any]:
    import cv2

    focal = max(image_size) / np.pi * 1.2
    K = np.array([[focal, 0, image_size[0] / 2], [0, focal, image_size[1] / 2], [0, 0, 1.0]])
    # OpenCV 5 moved the flags out of the module, with other values.
    names = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS")
    flags = sum(getattr(cv2.fisheye, name, None) or getattr(cv2, name) for name in names)
    _, K, distortion, *_ = cv2.fisheye.calibrate(
        [o.astype(np.float64) for o in objects], [i.astype(np.float64) for i in images],
        image_size, K, np.zeros((4, 1)), flags=flags, criteria=criteria,
    )  # fmt: skip
    return K, distortion


def _held_out(
    model: str, image_size: tuple[int, int], corners_m: Floats, corners_px: Floats
) -> float:
    """Return the root mean square error in pixels, over views that the fit did not have."""
    squares = []
    fold = np.arange(len(corners_px)) % FOLDS
    for out in range(FOLDS):
        try:
            camera = _fitted("held", model, image_size, corners_m, corners_px[fold != out])
        except (ValueError, InputError):
            return np.nan
        _, errors = resect(camera, corners_m, corners_px[fold == out])
        lost = np.isnan(errors[..., 0]) & np.isfinite(corners_px[fold == out][..., 0])
        if lost.mean() > 0.02:  # corners where this lens has no inverse
            return np.nan
        squares.append((errors[np.isfinite(errors[..., 0])] ** 2).sum(axis=-1))
    return float(np.sqrt(np.concatenate(squares).mean()))


def _without_outliers(
    image_size: tuple[int, int], corners_m: Floats, corners_px: Floats, used: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats]:
    """Leave out views that are blurred or misread, and corners that are somewhere else.

    A fit by squares gives way to the worst corners, so it is repeated without them until none is
    left out any more: those nearer are found when those farther are gone.

    Returns:
        Which views remain, and `(num_used, num_corners, 2)` their corners, NaN for what is left
        out.
    """
    cleaned = np.array(corners_px[used])
    for _ in range(CLEANINGS):
        # `(num_views, num_corners)` errors of the lens model that fits most corners best.
        best: Floats | None = None
        for model in ("pinhole", "fisheye"):
            try:
                camera = _fitted("first", model, image_size, corners_m, cleaned)
            except (ValueError, InputError):
                continue
            length = np.linalg.norm(resect(camera, corners_m, cleaned)[1], axis=-1)
            if best is None or np.nanmedian(length) < np.nanmedian(best):
                best = length
        if best is None:
            break
        length, typical = best, float(np.nanmedian(best))
        # A view is judged by its median: a few corners that are wrong are no reason to lose it.
        views = np.array([np.median(own[np.isfinite(own)]) if np.isfinite(own).any() else np.inf
                          for own in length])  # fmt: skip
        good = views <= max(OUTLIER_VIEW * float(np.median(views)), 0.3)
        wrong = length > max(OUTLIER_CORNER * typical, LEAST_PX)
        if good.sum() < MIN_VIEWS or (good.all() and not wrong.any()):
            break
        cleaned[wrong] = np.nan
        enough = good & (np.isfinite(cleaned[..., 0]).sum(axis=1) >= MIN_VIEW_CORNERS)
        used, cleaned = used[enough], cleaned[enough]
    return used, cleaned


def _fitted(
    camera_id: str, model: str, image_size: tuple[int, int], corners_m: Floats, corners_px: Floats
) -> Camera:
    """Return a camera at the origin; raise `ValueError` or `InputError` when there is no fit."""
    K, distortion = _fit(model, image_size, corners_m, corners_px)
    return Camera(camera_id, image_size, K, np.eye(4), distortion, model == "fisheye")


def _focal_sigma(camera: Camera, corners_m: Floats, corners_px: Floats, fit_px: float) -> float:
    """Return the standard deviation of the focal length, as a share of it."""
    boards = np.stack([_place_roughly(camera, corners_m, view) for view in corners_px])
    good = np.isfinite(boards).all(axis=(1, 2))
    result = adjust_boards(
        Rig((camera,)), boards[good], corners_m, corners_px[None, good], max(fit_px, 0.02),
        AdjustOptions(np.inf, np.zeros(1, dtype=bool), np.diag([1.0, 0, 0, 0]).reshape(1, 4, 1, 4)),
    )  # fmt: skip
    return float(np.sqrt(result.covariance[0, 6, 0, 6]))


GOOD_PX = 0.5  # a sharp board seen by a still camera is below this
POOR_PX = 1.5
UNSURE_FOCAL = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class LensReport:
    """One camera's intrinsics and the views behind them.

    Attributes:
        views: where the board was found.
        fit: what they say.
        next_steps: what to record for a better result, in words.
    """

    views: BoardViews
    fit: Intrinsics
    next_steps: list[str]


def make_report(views: BoardViews, fit: Intrinsics, corners_m: Floats) -> LensReport:
    """Judge a fit and say what to record next."""
    words = advice(corners_m, views.corners_px[fit.used], views.image_size)
    error = fit.held_out_px[fit.model]
    if error > POOR_PX:
        words.insert(
            0,
            f"the error of {error:.1f} px is high: keep the board flat (glue it to a plate), move "
            "it slowly or hold it still, and lock focus and zoom",
        )
    if fit.focal_sigma > UNSURE_FOCAL and not words:
        words.append("the focal length is unsure: add views with the board tilted and near")
    return LensReport(views, fit, words)


def as_values(report: LensReport) -> dict[str, Any]:
    """Return a report as plain values for JSON."""
    fit, views = report.fit, report.views
    K = fit.camera.K
    return {
        "camera": views.camera_id,
        "image_size": list(views.image_size),
        "model": fit.model,
        "focal_px": [float(K[0, 0]), float(K[1, 1])],
        "focal_sigma_px": float(fit.focal_sigma * K[0, 0]),
        "principal_point_px": [float(K[0, 2]), float(K[1, 2])],
        "distortion": fit.camera.distortion.tolist(),
        "known_to_deg": None
        if fit.camera.known_to is None
        else float(np.degrees(fit.camera.known_to)),
        "reprojection_error_px": fit.fit_px,
        "held_out_error_px": {
            name: None if np.isnan(value) else value for name, value in fit.held_out_px.items()
        },
        "frames_searched": views.searched,
        "frames_with_board": len(views.times_s),
        "frames_used": len(fit.used),
        "corners_by_part": covered(views.corners_px[fit.used], views.image_size).tolist(),
        "next": report.next_steps,
    }


def as_lines(report: LensReport) -> list[str]:
    """Return a report as lines of at most about 100 characters."""
    fit, views = report.fit, report.views
    K, (width, height) = fit.camera.K, views.image_size
    view = np.degrees(2 * np.arctan(width / 2 / K[0, 0]))
    parts = covered(views.corners_px[fit.used], views.image_size)
    others = ", ".join(
        f"{name} {'no fit' if np.isnan(value) else f'{value:.2f}'}"
        for name, value in fit.held_out_px.items()
        if name != fit.model
    )
    angle = "fisheye lens" if fit.model == "fisheye" else f"{view:.0f} degrees across"
    lines = [
        f"{views.camera_id}: {width} x {height}, {angle}",
        f"  focal length {K[0, 0]:.1f} +- {fit.focal_sigma * K[0, 0]:.1f} px, "
        f"principal point {K[0, 2]:.1f} {K[1, 2]:.1f}",
        f"  reprojection error {fit.held_out_px[fit.model]:.2f} px in held-out views "
        f"({fit.fit_px:.2f} in the fit): {_verdict(fit.held_out_px[fit.model])}",
        f"  lens {fit.model}{f' (held-out px of others: {others})' if others else ''}",
        f"  board in {len(views.times_s)} of {views.searched} frames, {len(fit.used)} used; "
        f"corners in {int((parts >= 4).sum())} of {GRID[0] * GRID[1]} parts of the picture",
    ]
    if fit.camera.known_to is not None:
        lines.append(
            f"  known up to {np.degrees(fit.camera.known_to):.0f} degrees off the axis, where the "
            "board was seen; farther out nothing is placed"
        )
    lines += [f"  next: {words}" for words in report.next_steps]
    return lines


def _verdict(error_px: float) -> str:
    if error_px <= GOOD_PX:
        return "good"
    return "usable" if error_px <= POOR_PX else "poor"


def draw_coverage(path: Path, reports: Sequence[LensReport]) -> None:
    """Draw where each picture was covered and how large errors are there, as .png or .svg."""
    from matplotlib.figure import Figure

    columns = min(len(reports), 3)
    rows = -(-len(reports) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, report in zip(axes, reports, strict=False):
        _draw_one(place, report)
    for place in axes[len(reports) :]:
        place.set_axis_off()
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=130)


def _draw_one(axes: Axes, report: LensReport) -> None:
    fit, (width, height) = report.fit, report.views.image_size
    used = report.views.corners_px[fit.used]
    seen = used[np.isfinite(used[..., 0])]
    errors = fit.errors_px[np.isfinite(used[..., 0])]
    dots = axes.scatter(
        seen[:, 0], seen[:, 1], c=errors, s=7, cmap="viridis", vmin=0, vmax=max(1.0, 2 * fit.fit_px)
    )
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(dots, ax=axes, label="error, px", shrink=0.8)
    for share in range(1, GRID[0]):
        axes.axvline(width * share / GRID[0], color="#d1d5db", lw=0.8)
    for share in range(1, GRID[1]):
        axes.axhline(height * share / GRID[1], color="#d1d5db", lw=0.8)
    for y, x in np.argwhere(covered(used, report.views.image_size) < 4).tolist():
        axes.text(
            (x + 0.5) * width / GRID[0], (y + 0.5) * height / GRID[1], "no\ncorners",
            ha="center", va="center", color="#d55e00", fontsize=8,
        )  # fmt: skip
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set_title(
        f"{report.views.camera_id}: {fit.model}, {len(fit.used)} views, "
        f"{fit.held_out_px[fit.model]:.2f} px", fontsize=9,
    )  # fmt: skip
    axes.tick_params(labelsize=7)
