"""Load what needs cameras that are placed: refuse those that are not, warn of odd axes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.base.quantities import shell
from e3pose.camera.provenance import load_provenance
from e3pose.cli.options import warn
from e3pose.cli.progress import notice_compiling
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration.world import require_placed, world_problem
from e3pose.recording.record import with_places

if TYPE_CHECKING:
    from e3pose.model.camera import Rig


def load_placed(path: Path) -> Recording:
    """Load a recording of the cameras that are placed; warn if its axes or unit look wrong."""
    notice_compiling()
    recording = without_unplaced(load_recording(path), path)
    rotations = load_provenance(path).rotations
    check_world(recording.rig, path, path / "calibration.toml", rotations)
    return recording


def without_unplaced(recording: Recording, where: object) -> Recording:
    """Leave out the cameras without a place, where others have one, and say so."""
    if recording.rig.unplaced:
        warn(f"{where}: left out without a place: {', '.join(recording.rig.unplaced)}")
    return with_places(recording)


def doubts(recording: Recording, path: Path, calibration: object = None) -> list[str]:
    """Return what makes the 3D of a recording doubtful, the worst first.

    Args:
        recording: as loaded.
        path: of it.
        calibration: the file to mend; that of the recording if None.
    """
    from e3pose.calibrate.people_3d import LYING, doubt_people

    recording = with_places(recording)
    if not recording.rig.placed:
        return []
    file = path / "calibration.toml" if calibration is None else calibration
    world = world_problem(recording.rig, file, load_provenance(path).rotations)[1]
    people = doubt_people(recording, load_noise(detector_of(recording)))
    if world and people.startswith(LYING):
        people = ""  # the axes again
    return [words.replace("CALIBRATION", shell(file)) for words in (people, world) if words]


def check_world(
    rig: Rig, where: object, file: object, rotations: Mapping[str, int] | None = None
) -> None:
    """Raise `InputError` unless cameras are placed; warn if axes or unit look wrong.

    Args:
        rig: the cameras.
        where: the recording or file that they are from.
        file: the calibration, for the command that mends it.
        rotations: by camera, degrees clockwise that make people in its images upright.
    """
    require_placed(rig, where)
    words = world_problem(rig, file, rotations)[1]
    warn(f"{where}: {words}" if words else "")
