"""`e3pose import` of research data sets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cyclopts import Parameter

from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError
from e3pose.cli.importing import (
    Dest,
    Folders,
    Overwrite,
    import_app,
    parse_folders,
    reading,
    save,
)
from e3pose.cli.options import Flag
from e3pose.cli.progress import track_progress
from e3pose_lab.datasets.bvh import import_bvh
from e3pose_lab.datasets.human36m import import_human36m
from e3pose_lab.datasets.motion import cmu_clips, import_cmu
from e3pose_lab.datasets.panoptic import import_panoptic
from e3pose_lab.datasets.published import SHELF, import_campus, import_published
from e3pose_lab.datasets.shelf import import_shelf


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Detections:
    """Keypoints for a data set that is published without any."""

    detections: Path | None = None
    """2D keypoints: a recording by `e3pose detect` of the images, or a folder of OpenPose JSON.
    Without it, the recording holds only the truth."""
    folder: Folders = None

    def folders(self) -> dict[str, str]:
        """Return the folder of each camera that was named."""
        return parse_folders(self.folder)


NO_DETECTIONS = Detections()


@import_app.command
def shelf(
    source: Path,
    dest: Dest,
    /,
    *,
    skeleton: Literal["coco17", "body25"] = "coco17",
    frames: str | None = None,
    detected: Detections = NO_DETECTIONS,
    overwrite: Overwrite = False,
) -> None:
    """Import the Shelf sequence: as published, or an .npz with OpenPose detections.

    Example: `e3pose import shelf Shelf recordings/shelf --detections found`

    Parameters
    ----------
    source
        The published folder (actorsGT.mat, Calibration/P0.txt or VoxelPose's
        calibration_shelf.json, Camera0), or an .npz with K, R, t,
        image_size, det_coco17 (or det_body25), det_view, det_frame and gt3d.
    skeleton
        Skeleton of the detections of an .npz.
    frames
        First and last frame of the published folder. Default: 300-600, which everybody scores.
    """
    check_free(dest, overwrite)
    if source.is_dir() or not (source.exists() or source.suffix.lower() == ".npz"):
        recording = import_published(
            source, SHELF, _range(frames), detected.detections, detected.folders(), reading
        )
        save(recording, dest, overwrite)
        return
    for option, value in (("--frames", frames), ("--detections", detected.detections)):
        if value is not None:
            raise InputError(option, f"with {source.name}", "the published folder of Shelf")
    save(import_shelf(source, skeleton), dest, overwrite)


@import_app.command
def campus(
    source: Path,
    dest: Dest,
    /,
    *,
    frames: str | None = None,
    detected: Detections = NO_DETECTIONS,
    overwrite: Overwrite = False,
) -> None:
    """Import the Campus sequence as published.

    Example: `e3pose import campus CampusSeq1 recordings/campus --detections found`

    Parameters
    ----------
    source
        The published folder (actorsGT.mat, Calibration/P0.txt or VoxelPose's
        calibration_campus.json, Camera0).
    frames
        First and last frame. Default: 350-750, of which 350 to 470 and 650 to 750 are scored.
    """
    check_free(dest, overwrite)
    recording = import_campus(
        source, _range(frames), detected.detections, detected.folders(), reading
    )
    save(recording, dest, overwrite)


@import_app.command
def human36m(
    source: Path,
    dest: Dest,
    /,
    *,
    subject: int,
    action: int,
    subaction: int = 1,
    detected: Detections = NO_DETECTIONS,
    overwrite: Overwrite = False,
) -> None:
    """Import one sequence of Human3.6M from its JSON annotations.

    Example: `e3pose import human36m h36m recordings/walking --subject 9 --action 14`

    Parameters
    ----------
    source
        Folder with Human36M_subject9_camera.json and Human36M_subject9_joint_3d.json, itself or in
        `annotations`.
    subject
        Subject: 1, 5, 6, 7, 8, 9 or 11.
    action
        Action, 2 to 16: directions, discussion, eating, greeting, phoning, posing, purchases,
        sitting, sitting down, smoking, photo, waiting, walking, walking a dog, walking together.
    subaction
        1 or 2.
    """
    check_free(dest, overwrite)
    recording = import_human36m(
        source, subject, action, subaction, detected.detections, detected.folders(), reading
    )
    save(recording, dest, overwrite)


def _range(text: str | None) -> tuple[int, int] | None:
    """Read a range such as 300-600; raise `InputError` for anything else."""
    if text is None:
        return None
    first, dash, last = text.partition("-")
    if not (dash and first.strip().isdigit() and last.strip().isdigit()):
        raise InputError("--frames", repr(text[:40]), "the first and last frame, such as 300-600")
    return int(first), int(last)


@import_app.command
def panoptic(
    source: Path,
    dest: Dest,
    /,
    *,
    cameras: str = "3,6,12,13,23",
    calibration: Path | None = None,
    detections: Path | None = None,
    folder: Folders = None,
    project_truth: Flag = False,
    overwrite: Overwrite = False,
) -> None:
    """Import a CMU Panoptic sequence: HD cameras, 3D truth, your own 2D detections.

    Example: `e3pose import panoptic 160906_band1 recordings/band --detections openpose_json`

    Parameters
    ----------
    source
        Sequence folder with calibration_*.json and hdPose3d_stage1_coco19, or an .npz with
        joints19_cm_conf or joints19_cm.
    cameras
        HD camera numbers, comma-separated. Default: the paper's five.
    calibration
        Calibration file, if SOURCE has none.
    detections
        Folder of OpenPose JSON, one folder per camera. Without it, the recording holds only the
        truth.
    project_truth
        Use exact projections of the truth as detections; the recording says so.
    """
    check_free(dest, overwrite)
    recording = import_panoptic(
        source,
        cameras=[name.strip() for name in cameras.split(",")],
        calibration=calibration,
        detections=detections,
        folders=parse_folders(folder),
        project_truth=project_truth,
        progress=reading,
    )
    save(recording, dest, overwrite)


@import_app.command
def cmu(
    source: Path,
    dest: Dest,
    /,
    *,
    clip: str | None = None,
    fps: float = 30.0,
    overwrite: Overwrite = False,
) -> None:
    """Import CMU motion capture clips, to train and evaluate predictors.

    Example: `e3pose import cmu cmu_mocap.npz recordings/cmu`

    The recordings hold only the truth, with simulated cameras around it.

    Parameters
    ----------
    source
        An .npz with joint_names and one array per clip, frames x 31 joints x 3, metres, z up.
    dest
        Folder to create, with one recording per clip; with --clip, the recording itself.
    clip
        Import only this clip, such as 02_01.
    fps
        Frame rate of the clips.
    overwrite
        Replace recordings at DEST.
    """
    clips = {clip: dest} if clip is not None else {name: dest / name for name in cmu_clips(source)}
    for path in clips.values():
        check_free(path, overwrite)
    for name, path in track_progress(clips.items(), len(clips), "reading"):
        save(import_cmu(source, name, fps), path, overwrite)


@import_app.command
def bvh(
    source: Path,
    dest: Dest,
    /,
    *,
    scale: float | None = None,
    up: Literal["y", "z"] = "y",
    overwrite: Overwrite = False,
) -> None:
    """Import motion capture of one person from a BVH file, such as recorded falls.

    Example: `e3pose import bvh fall.bvh recordings/fall`

    The recording holds only the truth, with made-up cameras around it. The floor is where the
    lowest joints are; the face is made up from head and neck.

    Parameters
    ----------
    source
        The file, with joints called as in Biovision, MotionBuilder, Mixamo, Poser, VRM or Unreal.
    scale
        Metres per unit of the file. Default: m, cm, mm or inches, whichever makes a person of
        usual size.
    up
        Axis of the file that points up.
    """
    check_free(dest, overwrite)
    recording, scale_m = import_bvh(source, scale, up == "z")
    save(recording, dest, overwrite)
    print(f"Unit of {source.name}: {scale_m:g} m; {recording.num_slots / recording.fps:.1f} s")
