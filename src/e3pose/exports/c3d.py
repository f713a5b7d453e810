"""C3D, binary marker files of motion capture, by ezc3d: z up, everybody in one file.

Points are labelled `track7:left_wrist`, as programs that know subjects do. The residual says where
a point comes from, as the format has it: -1 for missing, 0 for one that no view of the frame
measured (predicted or filled), else what it may be off by, here its standard deviation.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.exports.base import PER_METRE, ExportSettings, dense, person_name
from e3pose.files.atomic import atomic_file
from e3pose.model.take import MEASURED, MISSING, Take

LEAST_RESIDUAL_M = 1e-5  # of a measured point: 0 would say that it was not


def write_c3d(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take; frame 1 is the first of the take."""
    import ezc3d

    units = settings.units or "mm"
    joints_m, sigma_m, origin = dense(take)
    people, frames, joints = origin.shape
    scale = PER_METRE[units]
    # ezc3d: x, y, z and 1 by point and frame; points are person by person.
    points = np.ones((4, people * joints, frames))
    points[:3] = scale * joints_m.transpose(3, 0, 2, 1).reshape(3, people * joints, frames)
    measured = np.maximum(np.nan_to_num(sigma_m, nan=LEAST_RESIDUAL_M), LEAST_RESIDUAL_M)
    residual = np.where(origin == MEASURED, scale * measured, 0.0)
    residual = np.where(origin == MISSING, -1.0, residual)
    missing = (origin == MISSING).transpose(0, 2, 1).reshape(people * joints, frames)
    points[:3, missing] = 0.0  # what the residual declares invalid; some readers choke on NaN
    names = [person_name(motion.track_id) for motion in take.motions]
    file = ezc3d.c3d()
    file["header"]["points"]["first_frame"] = 0  # counted from 0 here, from 1 in the file
    parameters = file["parameters"]
    parameters["POINT"]["RATE"]["value"] = [take.fps]
    parameters["POINT"]["UNITS"]["value"] = [units]
    labels = [f"{name}:{joint}" for name in names for joint in take.skeleton.joints]
    parameters["POINT"]["LABELS"]["value"] = labels
    file.add_parameter("SUBJECTS", "USED", len(names))
    file.add_parameter("SUBJECTS", "USES_PREFIXES", 1)
    file.add_parameter("SUBJECTS", "NAMES", names)
    file.add_parameter("SUBJECTS", "LABEL_PREFIXES", [f"{name}:" for name in names])
    file.add_parameter("E3POSE", "START_S", [take.span[0] * take.interval_s])
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = residual.transpose(0, 2, 1).reshape(
        1, people * joints, frames
    )
    with atomic_file(dest, private=True) as temporary:
        file.write(str(temporary))
    return f"{units}, z up, {people * joints} points"
