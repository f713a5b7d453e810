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
from e3pose.cli.progress import track_progress
from e3pose.recording import Recording, save_recording
from e3pose.recording.detections.coco import import_coco
from e3pose.recording.detections.openpose import import_openpose

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
        help="CAMERA=FOLDER of the detections, if the names are ambiguous; repeatable.",
    ),
]


@import_app.command
def openpose(
    source: Path,
    dest: Dest,
    /,
    *,
    calibration: Calibration,
    fps: Rate,
    folder: Folders = None,
    overwrite: Overwrite = False,
) -> None:
    """Import OpenPose JSON: CAMERA/FRAME_keypoints.json with BODY_25, COCO-18 or COCO-17.

    Example: `e3pose import openpose pose-2d recordings/walk --calibration rig.toml --fps 60`

    A folder belongs to the camera whose id it has, exactly or with a suffix such as _json, or
    whose id it alone begins or ends with. A missing frame number is a lost view.

    Parameters
    ----------
    source
        Folder with one folder per camera.
    """
    check_free(dest, overwrite)
    recording = import_openpose(source, calibration, fps, parse_folders(folder), reading)
    save(recording, dest, overwrite)


@import_app.command
def coco(
    source: Path,
    dest: Dest,
    /,
    *,
    calibration: Calibration,
    fps: Rate,
    images: Path | None = None,
    detector: str = "",
    overwrite: Overwrite = False,
) -> None:
    """Import COCO keypoint results (also AlphaPose) of images named CAMERA/FRAME.

    Example: `e3pose import coco results.json recordings/walk --calibration rig.toml --fps 30`

    Parameters
    ----------
    source
        JSON list of results, or COCO data set with images and annotations.
    images
        COCO data set whose `images` table maps image_id to a file name.
    detector
        Detector of the results: the name of a shipped noise model such as openpose, or any other
        name. Without it, the noise is learned from a cautious start.
    """
    check_free(dest, overwrite)
    save(import_coco(source, calibration, fps, images, detector), dest, overwrite)


@import_app.command(show=False)
def videos(recording: Path, folder: Path, /) -> None:
    """Say what the verb for this is called now."""
    raise InputError("import videos", "no data set", f"`e3pose attach {recording} {folder}`")


def save(recording: Recording, dest: Path, overwrite: bool) -> None:
    """Write an imported recording, and say what it holds."""
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
