"""The check step: a second walk gives the expected error over the floor, and advice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.judge import Judgement, judge, poor_pairs
from e3pose.calibrate.recordings import first_seconds
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.solving import GOOD_MM, POOR_MM, SECONDS, grade
from e3pose.site.setup.tasks import Task


def check_command(setup: SetupSession) -> str:
    """Return the command line that checks."""
    walk = setup.shown(setup.folder / (setup.plan().second or "second"))
    return (
        f"e3pose calibrate check {walk} --calibration {setup.shown(setup.calibration)} "
        "--picture error.png"
    )


def start_checking(setup: SetupSession) -> None:
    """Judge the calibration by the second walk, in the background.

    Raises:
        InputError: where no second walk was recorded.
    """
    plan = setup.plan()
    if not plan.second:
        raise InputError("second walk", "none", "one that the calibration was not made from")

    def check(task: Task) -> None:
        task.progress("reading the second walk", 0, 0)
        recording = first_seconds(load_recording(setup.folder / plan.second), SECONDS)
        rig = load_rig(setup.calibration)
        rig = rig.subset([rig.index(name) for name in recording.rig.camera_ids])
        noise = load_noise(detector_of(recording))
        found = judge(replace(recording, rig=rig), noise, task.progress)
        setup.keep_result("check", result(rig, found))

    setup.start(Task("check", "Checking the calibration", check_command(setup)), check)


def result(rig: Rig, found: Judgement) -> dict[str, Any]:
    """Return a judgement for the page."""
    total = found.room.total_mm
    known = total[np.isfinite(total)]
    median, worst = (float(np.median(known)), float(known.max())) if len(known) else (np.nan,) * 2
    shares = [float(part.mean()) for part in (
        known <= GOOD_MM, (known > GOOD_MM) & (known <= POOR_MM), known > POOR_MM
    )] if len(known) else []  # fmt: skip
    return {
        "good_mm": GOOD_MM,
        "poor_mm": POOR_MM,
        "verdict": verdict(median, worst, shares),
        "grade": grade(median),
        "x_m": found.room.x_m.round(3).tolist(),
        "y_m": found.room.y_m.round(3).tolist(),
        "map_mm": [[round(v, 1) if np.isfinite(v) else None for v in row] for row in total],
        "centers": [
            {"id": camera.camera_id, "x": float(camera.center_m[0]), "y": float(camera.center_m[1])}
            for camera in rig.cameras
        ],
        "cameras": [
            {
                "id": name,
                "words": f"{found.errors_px[i]:.1f} px off where the others see people"
                if np.isfinite(found.errors_px[i]) else "saw no person that others saw",
                "expected": found.errors.expected_text(i),
            }
            for i, name in enumerate(rig.camera_ids)
        ],
        "next": [*found.next_steps, *(f"poor pair: {words}" for words in poor_pairs(rig, found))],
    }  # fmt: skip


def verdict(median_mm: float, worst_mm: float, shares: list[float]) -> str:
    """Return in one sentence how good a calibration is.

    Args:
        median_mm: of the error expected over the floor; NaN if it is known nowhere.
        worst_mm: likewise, the largest.
        shares: of the floor that is good, fair, poor.
    """
    if np.isnan(median_mm):
        return "No place of the floor was seen by two cameras at once."
    quality = {"good": "Good", "fair": "Usable", "poor": "Poor"}[grade(median_mm)]
    return (
        f"{quality}: a joint is expected to be {median_mm:.0f} mm off in the median over the "
        f"floor, {worst_mm:.0f} mm at the worst place; {100 * shares[0]:.0f} % of the floor is "
        "green."
    )
