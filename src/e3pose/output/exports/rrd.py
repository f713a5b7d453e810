"""RRD, recordings of the viewer rerun: points and limbs over time, z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.base.atomic import atomic_file
from e3pose.base.quantities import plural
from e3pose.model.take import Take
from e3pose.output.exports.base import ExportSettings, person_name


def write_rrd(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write everybody of a take; the timeline `time` counts seconds from slot 0."""
    import rerun

    stream = rerun.RecordingStream("e3pose", recording_id=take.name or None)
    names, limbs = take.skeleton.joints, np.array(take.skeleton.limbs).reshape(-1, 2)
    with atomic_file(dest, private=True) as temporary:
        stream.save(str(temporary))
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for motion in settings.progress(take.motions, len(take.motions), "write"):
            place = f"world/{person_name(motion.track_id)}"
            for row, (joints, known) in enumerate(zip(motion.joints_m, motion.known, strict=True)):
                slot = motion.first + row
                stream.set_time("slot", sequence=slot)
                stream.set_time("time", duration=slot * take.interval_s)
                if not known.any():
                    stream.log(place, rerun.Clear(recursive=True))
                    continue
                labels = [name for name, there in zip(names, known, strict=True) if there]
                points = rerun.Points3D(joints[known], labels=labels, show_labels=False)
                stream.log(f"{place}/joints", points)
                lines = [joints[limb] for limb in limbs if known[limb].all()]
                stream.log(f"{place}/limbs", rerun.LineStrips3D(lines))
            stream.set_time("slot", sequence=motion.first + len(motion))
            stream.set_time("time", duration=(motion.first + len(motion)) * take.interval_s)
            stream.log(place, rerun.Clear(recursive=True))
        stream.flush()
        stream.disconnect()
    return f"{plural(len(take.motions), 'person', 'people')}, metres, z up"
