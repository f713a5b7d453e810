"""Intrinsics of one camera from views of a board: Zhang's method, with a choice of lens model.

Z. Zhang, "A flexible new technique for camera calibration" (2000); the fisheye model is that of
Kannala and Brandt (2006), as OpenCV has it. Every model is fitted without some of the views and
judged by its reprojection error in those; the simplest that is about as good as the best is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.bundle import AdjustOptions, adjust_boards
from e3pose.calibrate.view_choice import choose_views, tilted_views
from e3pose.model.camera import Camera, Rig

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
    _check_tilted(camera_id, corners_m, corners_px[used], image_size)
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
        camera = replace(camera, known_to=_filmed_angle(camera, cleaned))
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
        length = _best_errors(image_size, corners_m, cleaned)
        if length is None:
            break
        typical = float(np.nanmedian(length))
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


def _best_errors(
    image_size: tuple[int, int], corners_m: Floats, corners_px: Floats
) -> Floats | None:
    """Return `(num_views, num_corners)` errors of the lens model that fits most corners best."""
    best: Floats | None = None
    for model in ("pinhole", "fisheye"):
        try:
            camera = _fitted("first", model, image_size, corners_m, corners_px)
        except (ValueError, InputError):
            continue
        length = np.linalg.norm(resect(camera, corners_m, corners_px)[1], axis=-1)
        if best is None or np.nanmedian(length) < np.nanmedian(best):
            best = length
    return best


def _fitted(
    camera_id: str, model: str, image_size: tuple[int, int], corners_m: Floats, corners_px: Floats
) -> Camera:
    """Return a camera at the origin; raise `ValueError` or `InputError` when there is no fit."""
    K, distortion = _fit(model, image_size, corners_m, corners_px)
    return Camera(camera_id, image_size, K, np.eye(4), distortion, model == "fisheye")


def _check_tilted(
    camera_id: str, corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]
) -> None:
    """Raise `InputError` if the board was never tilted."""
    tilted = int(tilted_views(corners_m, corners_px, image_size).any(axis=1).sum())
    if tilted < MIN_TILTED:
        raise InputError(
            f"camera {camera_id}: found {tilted} views of a tilted board, expected at least "
            f"{MIN_TILTED}: a board held parallel to the image does not tell the focal length; "
            "record it again, tilted by 20 to 40 degrees to all sides"
        )


def _filmed_angle(camera: Camera, corners_px: Floats) -> float:
    """Return the angle off the axis, radians, up to which corners were seen."""
    seen = camera.normalise(corners_px[np.isfinite(corners_px[..., 0])])
    angles = np.sort(np.arctan(np.hypot(*seen.T)))
    return float(angles[np.isfinite(angles)][-FILMED_CORNERS:][0])


def _focal_sigma(camera: Camera, corners_m: Floats, corners_px: Floats, fit_px: float) -> float:
    """Return how well the views fix the focal length, as a share of it."""
    boards = np.stack([_place_roughly(camera, corners_m, view) for view in corners_px])
    good = np.isfinite(boards).all(axis=(1, 2))
    result = adjust_boards(
        Rig((camera,)), boards[good], corners_m, corners_px[None, good], max(fit_px, 0.02),
        AdjustOptions(np.inf, np.zeros(1, dtype=bool), np.diag([1.0, 0, 0, 0]).reshape(1, 4, 1, 4)),
    )  # fmt: skip
    return float(np.sqrt(result.covariance[0, 6, 0, 6]))
