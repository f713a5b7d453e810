"""Load recordings that need placed cameras: refuse unplaced ones, warn of odd axes."""

from __future__ import annotations

from pathlib import Path

from e3pose.base.quantities import plural, shell
from e3pose.calibrate.people_3d import LYING, doubt_people
from e3pose.camera.provenance import load_provenance
from e3pose.cli.options import warn
from e3pose.cli.progress import notice_compiling
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration.world import require_placed, world_problem
from e3pose.recording.problems import HARMLESS, Problem, find_problems
from e3pose.recording.record import with_places

MOST_WARNINGS = 3


def load_placed(path: Path, warned: bool = False) -> Recording:
    """Load a recording of the cameras that are placed.

    Args:
        path: of it.
        warned: whether the caller warns of its problems; else odd axes or units are told.
    """
    notice_compiling()
    recording = without_unplaced(load_recording(path), path)
    require_placed(recording.rig, path)
    if not warned:
        rotations = load_provenance(path).rotations
        words = world_problem(recording.rig, path / "calibration.toml", rotations)[1]
        warn(f"{path}: {words}" if words else "")
    return recording


def without_unplaced(recording: Recording, where: object) -> Recording:
    """Leave out the cameras without a place, where others have one, and say so."""
    if recording.rig.unplaced:
        warn(f"{where}: left out without a place: {', '.join(recording.rig.unplaced)}")
    return with_places(recording)


def problems_of(recording: Recording, path: Path, calibration: object = None) -> list[Problem]:
    """Return all problems of a recording, with those that its people reveal of its rig.

    Args:
        recording: as loaded.
        path: of it.
        calibration: the file to mend; that of the recording if None.
    """
    file = path / "calibration.toml" if calibration is None else calibration
    found = find_problems(recording, path, load_provenance(path).rotations, file)
    placed = with_places(recording)
    people = doubt_people(placed, load_noise(detector_of(recording)), file)
    if people and not (people.startswith(LYING) and any(p.kind == "not-z-up" for p in found)):
        found.insert(0, Problem("people", "rig", people))
    return sorted(found, key=lambda problem: problem.where != "rig")


def warn_of_problems(recording: Recording, path: Path, calibration: object = None) -> list[Problem]:
    """Warn of problems that spoil a recording's 3D, the worst first; return all of them."""
    found = problems_of(recording, path, calibration)
    words = [f"{one.where}: {one.message}" for one in found if one.kind not in HARMLESS]
    for line in words[:MOST_WARNINGS]:
        warn(f"{path}: {line}")
    if len(words) > MOST_WARNINGS:
        more = plural(len(words) - MOST_WARNINGS, "more problem")
        warn(f"{path}: {more}: e3pose info {shell(path)}")
    return found
