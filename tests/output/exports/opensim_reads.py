"""Run by a Python that has OpenSim: scale a model and run inverse kinematics on an export.

    python opensim_reads.py FOLDER/walk

Prints what OpenSim read and by how much its markers miss those of the file, as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import opensim  # type: ignore[import-not-found]

MM = 1000.0


def main(walk: Path) -> dict[str, Any]:
    os.chdir(walk.parent)  # the set-ups name files beside them
    stem = walk.name
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(f"{stem}-model.osim")
    mass_kg = model.getTotalMass(model.initSystem())
    scaled = opensim.ScaleTool(f"{stem}-scale.xml").run()
    solved = opensim.InverseKinematicsTool(f"{stem}-ik.xml").run()
    return {
        "markers": list(opensim.TimeSeriesTableVec3(f"{stem}.trc").getColumnLabels()),
        "mass_kg": mass_kg,
        "scaled": scaled,
        "solved": solved,
        "ik_mm": off_mm(stem, f"{stem}-ik.mot"),
        "mot_mm": off_mm(stem, f"{stem}.mot"),
    }


def off_mm(stem: str, motion: str) -> float:
    """Return how far the scaled model's markers are from the file's, on average, in a motion."""
    model = opensim.Model(f"{stem}-scaled.osim")
    state = model.initSystem()
    markers = opensim.TimeSeriesTableVec3(f"{stem}.trc")
    labels = list(markers.getColumnLabels())
    table = opensim.TimeSeriesTable(motion)
    found = []
    for row, time_s in enumerate(table.getIndependentColumn()):
        place = int(markers.getNearestRowIndexForTime(time_s))
        values = table.getRowAtIndex(row).to_numpy()
        for name, value in zip(table.getColumnLabels(), values, strict=True):
            shift = name in ("pelvis_tx", "pelvis_ty", "pelvis_tz")
            number = float(value if shift else np.radians(value))
            model.getCoordinateSet().get(name).setValue(state, number, False)
        model.realizePosition(state)
        for index in range(model.getMarkerSet().getSize()):
            marker = model.getMarkerSet().get(index)
            there = marker.getLocationInGround(state).to_numpy()
            cell = markers.getRowAtIndex(place).getElt(0, labels.index(marker.getName()))
            found.append(np.linalg.norm(MM * there - cell.to_numpy()))
    return float(np.nanmean(found))


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
