"""Draw the expected error over the floor: a heat map with the cameras around it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.calibrate.expected_error import ErrorMap
from e3pose.model.camera import Rig


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
