"""MOT, motions of OpenSim: a table of coordinates over time, one person per file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.model.take import Take
from e3pose.output.exports.base import ExportSettings, person_name
from e3pose.output.exports.opensim.coordinates import NEEDED, coordinates, in_every_frame


def write_mot(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the one person of a take; an angle that a frame does not tell is the one before.

    Raises:
        InputError: for a skeleton without hips and shoulders, or a person who never shows them.
    """
    (motion,) = take.motions
    lacking = [joint for joint in NEEDED if joint not in take.skeleton.joints]
    if lacking:
        raise InputError(f"{dest}: found a skeleton without {lacking[0]}, expected {NEEDED}")
    columns = [take.skeleton.index(joint) for joint in NEEDED]
    if not motion.known[:, columns].all(axis=1).any():
        raise InputError(
            f"{person_name(motion.track_id)}: found no frame with hips and shoulders, expected "
            "one: leave the person out with --track"
        )
    found = coordinates(motion.joints_m, take.skeleton)
    whole = {name: in_every_frame(values) for name, values in found.items()}
    times_s = (motion.first + np.arange(len(motion))) * take.interval_s
    table = np.column_stack([times_s, *(values for values, _ in whole.values())])
    header = [
        dest.stem, "version=1", f"nRows={len(table)}", f"nColumns={table.shape[1]}",
        "inDegrees=yes", "endheader", "\t".join(["time", *whole]),
    ]  # fmt: skip
    with (
        atomic_file(dest, private=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write("\n".join(header) + "\n")
        np.savetxt(file, table, fmt="%.6f", delimiter="\t")
    kept = sum(count for _, count in whole.values())
    share = kept / (len(table) * len(whole))
    note = f"; {100 * share:.1f} % of the values are those of an earlier frame" if kept else ""
    return f"{len(whole)} coordinates, degrees and metres, y up{note}"
