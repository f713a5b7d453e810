"""Expected 3D error of a calibration over the room, from keypoint noise and its own covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.calibrate.bundle import root_mean_square
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.projection import project
from e3pose.model.rotations import similarity

HEIGHTS_M = (0.2, 1.0, 1.6)  # feet, hips, heads
CELL_M = 0.2
MOST_CELLS = 10_000
MARGIN_M = 0.5  # around where people were


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMap:
    """Expected error of one joint over the floor.

    Attributes:
        x_m: `(num_columns,)` middles of the cells.
        y_m: `(num_rows,)` likewise.
        noise_mm: `(num_rows, num_columns)` from the keypoints' noise, mean over heights; NaN where
            fewer than two cameras see.
        calibration_mm: likewise, from the difference to the rig that the same people would give;
            NaN where that is unknown.
        cameras: `(num_rows, num_columns)` how many cameras see a hip there.
    """

    x_m: Floats
    y_m: Floats
    noise_mm: Floats
    calibration_mm: Floats
    cameras: NDArray[np.int64]

    @property
    def total_mm(self) -> Floats:
        """`(num_rows, num_columns)` both together."""
        return np.hypot(self.noise_mm, np.nan_to_num(self.calibration_mm))


def error_map(rig: Rig, sigma_px: Floats, places_m: Floats, resolved: Sequence[Rig]) -> ErrorMap:
    """Work out the expected error of joints over the floor.

    Args:
        rig: the calibration in question, z up.
        sigma_px: `(num_cameras,)` standard deviation of keypoints in each camera.
        places_m: `(n, 2)` where people were, to choose the area by.
        resolved: rigs that people give, each in any world; none if unknown.
    """
    low = np.quantile(places_m, 0.01, axis=0) - MARGIN_M
    high = np.quantile(places_m, 0.99, axis=0) + MARGIN_M
    cell = max(CELL_M, float(np.sqrt(np.prod(high - low) / MOST_CELLS)))
    x_m, y_m = (np.arange(low[i], high[i] + cell / 2, cell) for i in (0, 1))
    shape = (len(HEIGHTS_M), len(y_m), len(x_m))
    z, y, x = np.meshgrid(np.array(HEIGHTS_M), y_m, x_m, indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    sees = np.stack([camera.sees(points) for camera in rig.cameras])
    noise = 1000 * np.sqrt(np.trace(covariances(rig, points, sigma_px), axis1=-2, axis2=-1))
    noise = np.where(sees.sum(axis=0) >= 2, noise, np.nan).reshape(shape)
    shift = np.full(len(points), np.nan)
    if resolved:
        shifts = np.stack([calibration_shift(rig, other, points) for other in resolved])
        shift = 1000 * root_mean_square(shifts, axis=0)
    shift = np.where(np.isfinite(noise), shift.reshape(shape), np.nan)
    return ErrorMap(
        x_m,
        y_m,
        _mean(noise),
        _mean(shift),
        sees.reshape(len(rig), *shape)[:, 1].sum(axis=0),
    )


def covariances(rig: Rig, points_m: Floats, sigma_px: Floats) -> Floats:
    """Return `(n, 3, 3)` covariances of triangulated points, square metres (Hartley-Zisserman 5.2).

    Args:
        rig: the cameras.
        points_m: `(n, 3)`.
        sigma_px: `(num_cameras,)` standard deviation of either coordinate.
    """
    _, _, slope = project(points_m, rig.projections)
    sees = np.stack([camera.sees(points_m) for camera in rig.cameras])
    precision = np.where(sees, 1 / sigma_px[:, None] ** 2, 0.0)
    information = np.einsum("cn,cnui,cnuj->nij", precision, slope, slope)
    trace = np.trace(information, axis1=-2, axis2=-1)
    return np.asarray(
        np.linalg.inv(information + (1e-9 * trace + 1e-12)[:, None, None] * np.eye(3))
    )


def calibration_shift(rig: Rig, resolved: Rig, points_m: Floats) -> Floats:
    """Return `(n,)` metres by which a rig misplaces points, if another rig is the right one.

    Both are brought together by the similarity that fits their cameras and points best, as a scale
    and a world of its own are no error of shape.

    Args:
        rig: the calibration in question.
        resolved: the other.
        points_m: `(n, 3)` in the world of `rig`.
    """
    scale, R, t = similarity(resolved.centers_m, rig.centers_m)
    for last in (False, False, True):  # the second and third time by the points themselves
        inside = (points_m - t) @ R / scale
        seen = np.stack([
            np.where(camera.sees(points_m)[:, None], other.project(inside), np.nan)
            for camera, other in zip(rig.cameras, resolved.cameras, strict=True)
        ])  # fmt: skip
        found = place_points(rig, seen, np.ones(seen.shape[:2]))
        good = np.isfinite(found).all(axis=-1)
        if last:
            break
        if good.sum() < 10:
            return np.full(len(points_m), np.nan)
        scale, R, t = similarity(inside[good], found[good])
    return np.asarray(np.linalg.norm(found - points_m, axis=-1))


def _mean(values: Floats) -> Floats:
    """Average over heights where most of them are known."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count >= 2, total / np.maximum(count, 1), np.nan)


def draw_error(path: Path, room: ErrorMap, rig: Rig) -> None:
    """Draw as .png or .svg: expected error, and the number of cameras that see a hip."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    half_x = (room.x_m[1] - room.x_m[0]) / 2 if len(room.x_m) > 1 else 0.1
    half_y = (room.y_m[1] - room.y_m[0]) / 2 if len(room.y_m) > 1 else 0.1
    extent = (
        room.x_m[0] - half_x, room.x_m[-1] + half_x, room.y_m[0] - half_y, room.y_m[-1] + half_y,
    )  # fmt: skip
    total = room.total_mm
    known = total[np.isfinite(total)]
    most = float(np.quantile(known, 0.98)) if len(known) else 1.0
    shown = left.imshow(
        total, origin="lower", extent=extent, cmap="viridis_r", vmin=0, vmax=max(most, 1.0)
    )
    figure.colorbar(shown, ax=left, label="mm", shrink=0.85)
    left.set_title("expected 3D error of a joint, noise and calibration", fontsize=10)
    seen = right.imshow(
        room.cameras, origin="lower", extent=extent, cmap="Blues", vmin=0, vmax=len(rig)
    )
    bar = figure.colorbar(seen, ax=right, label="cameras", shrink=0.85)
    bar.locator = MaxNLocator(integer=True)
    bar.update_ticks()
    right.set_title("cameras that see a hip", fontsize=10)
    for axes in (left, right):
        for camera in rig.cameras:
            x, y = camera.center_m[:2]
            ahead = camera.R[2, :2] / max(float(np.hypot(*camera.R[2, :2])), 1e-6)
            axes.plot([x, x + 0.6 * ahead[0]], [y, y + 0.6 * ahead[1]], color="#d55e00", lw=1.5)
            axes.plot(x, y, "s", color="#d55e00", ms=5)
            axes.annotate(
                camera.camera_id, (x, y), textcoords="offset points", xytext=(5, 5), fontsize=8
            )
        axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
        axes.autoscale(True)
        axes.margins(0.15)  # room for the names of cameras at the edge
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=120)
