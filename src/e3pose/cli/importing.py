"""`e3pose import`: make a recording from another format; data sets are the lab's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.cli.distributions import add_absent
from e3pose.cli.options import Flag
from e3pose.cli.placed import warn_of_problems
from e3pose.cli.progress import track_progress
from e3pose.recording import Recording, save_recording
from e3pose.recording.detections.importing import ImportSettings, import_detections

import_app = App(name="import", help="Convert a data set or detections into a recording.")

Dest = Annotated[Path, Parameter(help="Recording folder to create.")]
Overwrite = Annotated[bool, Parameter(negative="", help="Replace the recording at DEST.")]
Calibration = Annotated[Path, Parameter(help="Calibration file of the cameras.")]
Rate = Annotated[float, Parameter(help="Frame rate of the cameras.")]
Folders = Annotated[
    list[str] | None,
    Parameter(
        name="--folder",
        negative="",
        help="CAMERA=NAME of the folder or file, if the names are ambiguous; repeatable.",
    ),
]


@import_app.command(name=("detections", "openpose", "coco"))
def detections(
    source: Path,
    dest: Dest,
    /,
    *,
    calibration: Calibration,
    fps: Rate,
    folder: Folders = None,
    images: Path | None = None,
    skeleton: str | None = None,
    detector: str = "",
    score_scale: float | None = None,
    strict: Flag = False,
    overwrite: Overwrite = False,
) -> None:
    """Import the 2D poses of another tool: OpenPose, AlphaPose, MMPose, DeepLabCut and others.

    Example: `e3pose import detections pose-2d walk --calibration rig.toml --fps 60`

    Example: `e3pose import detections results.json walk --calibration rig.toml --fps 30`

    A folder or file belongs to the camera whose id its name is or holds, or else whose last number
    it has; in one file of all cameras, images are named CAMERA/FRAME. A missing frame number is a
    lost view. What cannot be read costs that view alone, and is counted.

    Parameters
    ----------
    source
        Folder with a folder or file per camera, or one file: JSON, CSV or .npy.
    images
        COCO data set whose `images` table maps image_id to a file name.
    skeleton
        Skeleton of the keypoints, such as body25b, where their number does not tell, or your own:
        a TOML file. One with fewer joints keeps these alone.
    detector
        Detector of the results: the name of a shipped noise model such as openpose, or any other
        name. Without it, the noise is learned from a cautious start.
    score_scale
        Number that scores are divided by. Default: their highest, if it is above 1.5.
    strict
        Refuse files and people that cannot be read.
    """
    check_free(dest, overwrite)
    settings = ImportSettings(
        parse_folders(folder), images, skeleton, score_scale, detector, strict
    )
    recording, notes = import_detections(source, calibration, fps, settings, reading)
    save(recording, dest, overwrite)
    for note in notes:
        print(f"  {note}")
    warn_of_problems(recording, dest)


def save(recording: Recording, dest: Path, overwrite: bool) -> None:
    """Write an imported recording, and print its content."""
    save_recording(recording, dest, overwrite=overwrite)
    people = sum(len(series.scores) for series in recording.views)
    print(
        f"Wrote {dest}: {plural(len(recording.rig), 'camera')}, "
        f"{plural(recording.num_slots, 'slot')} at "
        f"{recording.fps:g} fps, {plural(people, '2D pose')} ({recording.skeleton.name})"
        + (
            f", truth of {plural(len(recording.truth.person_ids), 'person', 'people')}"
            if recording.truth
            else ""
        )
    )


def parse_folders(pairs: Sequence[str] | None) -> dict[str, str]:
    """Read CAMERA=FOLDER of `--folder`; raise `InputError` for anything else."""
    folders: dict[str, str] = {}
    for pair in pairs or ():
        camera_id, separator, name = pair.partition("=")
        if not separator or not camera_id or not name or camera_id in folders:
            raise InputError(f"--folder: found {pair[:120]!r}, expected CAMERA=FOLDER, once each")
        folders[camera_id] = name
    return folders


def reading(paths: Sequence[Path]) -> Iterable[Path]:
    """Yield files that are read, with progress."""
    return track_progress(paths, len(paths), "reading")


add_absent(import_app)
