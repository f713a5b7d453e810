"""`e3pose import`: make a recording from another format."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from e3pose.errors import InputError
from e3pose.plural import counted

if TYPE_CHECKING:
    from e3pose.recording import Recording

import_app = App(name="import", help="Make a recording from another format.")

Overwrite = Annotated[bool, Parameter(negative="")]
Folders = Annotated[list[str] | None, Parameter(name="--folder", negative="")]


@import_app.command
def shelf(
    source: Path,
    dest: Path,
    *,
    skeleton: Literal["coco17", "body25"] = "coco17",
    overwrite: Overwrite = False,
) -> None:
    """Import the Shelf sequence with its OpenPose detections and its annotated actors.

    Example: e3pose import shelf shelf.npz recordings/shelf

    Parameters
    ----------
    source
        An .npz with K, R, t, image_size, det_coco17 (or det_body25), det_view, det_frame and gt3d.
    dest
        The recording folder to make.
    skeleton
        Which of the detections to take.
    overwrite
        Replace the recording at DEST.
    """
    from e3pose.recording.datasets.shelf import import_shelf

    _check_free(dest, overwrite)
    _save(import_shelf(source, skeleton), dest, overwrite)


@import_app.command
def panoptic(
    source: Path,
    dest: Path,
    *,
    cameras: str = "3,6,12,13,23",
    calibration: Path | None = None,
    detections: Path | None = None,
    folder: Folders = None,
    project_truth: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Import a CMU Panoptic sequence: its HD cameras, its 3D truth, and your 2D detections of it.

    Example: e3pose import panoptic 160906_band1 recordings/band --detections openpose_json

    Parameters
    ----------
    source
        The folder of a sequence, with calibration_*.json and hdPose3d_stage1_coco19, or an .npz
        with joints19_cm_conf or joints19_cm.
    dest
        The recording folder to make.
    cameras
        HD cameras by number, separated by commas; the paper's five by default.
    calibration
        A calibration file, where SOURCE has none.
    detections
        A folder of OpenPose JSON with a folder per camera. Without it the recording holds the truth
        alone.
    folder
        CAMERA=FOLDER below DETECTIONS, where names alone do not tell; repeatable.
    project_truth
        Put exact projections of the truth in the place of detections, and say so in the recording.
    overwrite
        Replace the recording at DEST.
    """
    from e3pose.recording.datasets.panoptic import import_panoptic

    _check_free(dest, overwrite)
    recording = import_panoptic(
        source,
        cameras=[name.strip() for name in cameras.split(",")],
        calibration=calibration,
        detections=detections,
        folders=_parse_folders(folder),
        project_truth=project_truth,
        progress=_progress,
    )
    _save(recording, dest, overwrite)


@import_app.command
def openpose(
    source: Path,
    dest: Path,
    *,
    calibration: Path,
    fps: float,
    folder: Folders = None,
    overwrite: Overwrite = False,
) -> None:
    """Import OpenPose JSON: CAMERA/FRAME_keypoints.json with BODY_25, COCO-18 or COCO-17.

    The folder of a camera is found by its id: exactly, or with an ending such as _json, or as the
    only one that begins or ends with it. A frame number that a camera lacks is a lost view.

    Example: e3pose import openpose pose-2d recordings/walk --calibration Calib.toml --fps 60

    Parameters
    ----------
    source
        A folder with a folder per camera.
    dest
        The recording folder to make.
    calibration
        The calibration file of the cameras.
    fps
        Frames a second of the cameras.
    folder
        CAMERA=FOLDER, where names alone do not tell; repeatable.
    overwrite
        Replace the recording at DEST.
    """
    from e3pose.recording.datasets.openpose import import_openpose

    _check_free(dest, overwrite)
    recording = import_openpose(source, calibration, fps, _parse_folders(folder), _progress)
    _save(recording, dest, overwrite)


@import_app.command
def coco(
    source: Path,
    dest: Path,
    *,
    calibration: Path,
    fps: float,
    images: Path | None = None,
    detector: str = "",
    overwrite: Overwrite = False,
) -> None:
    """Import COCO keypoint results, or AlphaPose's, whose images are named CAMERA/FRAME.

    Example: e3pose import coco results.json recordings/walk --calibration rig.toml --fps 30

    Parameters
    ----------
    source
        A JSON list of results, or a COCO dataset with images and annotations.
    dest
        The recording folder to make.
    calibration
        The calibration file of the cameras.
    fps
        Frames a second of the cameras.
    images
        A COCO dataset whose table of images says which file an image_id is.
    detector
        What made the results: the name of a shipped noise file such as openpose, or any other name.
        Without it, replay learns how far off the keypoints are from a cautious start.
    overwrite
        Replace the recording at DEST.
    """
    from e3pose.recording.datasets.coco import import_coco

    _check_free(dest, overwrite)
    _save(import_coco(source, calibration, fps, images, detector), dest, overwrite)


@import_app.command
def cmu(
    source: Path,
    dest: Path,
    *,
    clip: str | None = None,
    fps: float = 30.0,
    overwrite: Overwrite = False,
) -> None:
    """Import clips of the CMU motion capture database: truth to train and measure predictors.

    Nobody filmed these people: the recordings hold truth alone, and made-up cameras around it.

    Example: e3pose import cmu cmu_mocap.npz recordings/cmu

    Parameters
    ----------
    source
        An .npz with joint_names and an array per clip, frames x 31 joints x 3, metres, z up.
    dest
        The folder to make recordings in, one of each clip's name; the recording itself with --clip.
    clip
        One clip by name, such as 02_01; all of them by default.
    fps
        Frames a second of the clips.
    overwrite
        Replace recordings at DEST.
    """
    from e3pose.cli.progress import track_progress
    from e3pose.recording.datasets.motion import cmu_clips, import_cmu

    clips = {clip: dest} if clip is not None else {name: dest / name for name in cmu_clips(source)}
    for path in clips.values():
        _check_free(path, overwrite)
    for name, path in track_progress(clips.items(), len(clips), "reading"):
        _save(import_cmu(source, name, fps), path, overwrite)


def _check_free(dest: Path, overwrite: bool) -> None:
    """Refuse before minutes of reading, not after."""
    from e3pose.files.atomic import check_free

    check_free(dest, overwrite)


def _save(recording: Recording, dest: Path, overwrite: bool) -> None:
    from e3pose.recording import save_recording

    save_recording(recording, dest, overwrite=overwrite)
    people = sum(len(series.scores) for series in recording.views)
    print(
        f"{dest}: {counted(len(recording.rig), 'camera')}, "
        f"{counted(recording.num_slots, 'slot')} at "
        f"{recording.fps:g} fps, {counted(people, '2D pose')} ({recording.skeleton.name})"
        + (
            f", truth of {counted(len(recording.truth.person_ids), 'person', 'people')}"
            if recording.truth
            else ""
        )
    )


def _parse_folders(pairs: Sequence[str] | None) -> dict[str, str]:
    folders: dict[str, str] = {}
    for pair in pairs or ():
        camera_id, separator, name = pair.partition("=")
        if not separator or not camera_id or not name or camera_id in folders:
            raise InputError(f"--folder: found {pair[:120]!r}, expected CAMERA=FOLDER, once each")
        folders[camera_id] = name
    return folders


def _progress(paths: Sequence[Path]) -> Iterable[Path]:
    from e3pose.cli.progress import track_progress

    return track_progress(paths, len(paths), "reading")
