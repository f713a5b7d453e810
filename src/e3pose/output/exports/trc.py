"""TRC, marker files of OpenSim and Pose2Sim: text, y up, one person per file.

The layout is that of OpenSim's documentation (Marker (.trc) Files): five lines of header, a blank
one, a row per frame. A marker that is missing is `NaN`: OpenSim drops an empty cell at the end of a
row and then refuses the row.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.model.take import Take
from e3pose.output.exports.base import PER_METRE, ExportSettings, y_up
from e3pose.output.exports.opensim.markers import columns
from e3pose.output.exports.opensim.setup import write_setup

DECIMALS = {"mm": 3, "m": 6}


def write_trc(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the one person of a take.

    Time counts from slot 0, so that files of several people belong together. With names of another
    tool, what OpenSim needs to scale a model and to run inverse kinematics is written beside it.
    """
    (motion,) = take.motions
    units = settings.units or "mm"
    markers, rate = columns(take.skeleton, settings.names), f"{take.fps:.10g}"
    names = [name for name, _ in markers]
    cells = [f"{name}\t\t" for name in names]
    axes = "\t".join(f"X{n}\tY{n}\tZ{n}" for n in range(1, len(names) + 1))
    count = len(motion)
    header = [
        f"PathFileType\t4\t(X/Y/Z)\t{dest.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\t"
        "OrigNumFrames",
        f"{rate}\t{rate}\t{count}\t{len(names)}\t{units}\t{rate}\t1\t{count}",
        "Frame#\tTime\t" + "\t".join(cells),
        "\t\t" + axes,
        "",
    ]
    joints_m = [motion.joints_m[:, joints].mean(axis=1) for _, joints in markers]
    places = y_up(np.stack(joints_m, axis=1)) * PER_METRE[units]
    form = f"%.{DECIMALS[units]}f"
    with (
        atomic_file(dest, private=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write("\n".join(header) + "\n")
        for row, place in enumerate(places.reshape(count, -1)):
            time_s = (motion.first + row) * take.interval_s
            values = ["NaN" if np.isnan(value) else form % value for value in place.tolist()]
            file.write(f"{row + 1}\t{time_s:.6f}\t" + "\t".join(values) + "\n")
    if settings.names is None:
        return f"{units}, y up"
    return f"{units}, y up; {write_setup(dest, take, settings.names, settings.osim)}"
