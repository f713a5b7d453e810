"""2D keypoints for a data set without any: a recording of its images, or OpenPose JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.recording import ViewSeries, load_recording
from e3pose.recording.detections.importing import Progress, read_detections


@dataclass(frozen=True, slots=True)
class Detected:
    """The views of a data set.

    Attributes:
        skeleton: of the keypoints.
        views: one series a camera; without a view where nothing was detected.
        note: what they are, for the recording's source.
        detector: what found them; empty where unknown.
    """

    skeleton: Skeleton
    views: tuple[ViewSeries, ...]
    note: str
    detector: str


def detected_views(
    detections: Path | None,
    rig: Rig,
    fps: float,
    frames: tuple[int, int],
    first_image: Callable[[], int],
    folders: Mapping[str, str],
    progress: Progress,
) -> Detected:
    """Read what was detected in the images of a data set.

    Args:
        detections: a folder of OpenPose JSON with the frame numbers of the images, or a recording
            that `e3pose detect` made of all images; None for no views.
        rig: the cameras.
        fps: slots per second.
        frames: first and last frame number, of which the first is slot 0.
        first_image: tells the number of the image at which `e3pose detect` begins to count.
        folders: camera id to folder name below `detections`.
        progress: wraps the list of files that is read.

    Raises:
        InputError: naming what is wrong, or saying that no view is of these frames.
    """
    if detections is None:
        nothing = ViewSeries.from_views([], [], [], len(COCO17))
        return Detected(COCO17, (nothing,) * len(rig), " Truth only, without 2D keypoints.", "")
    if (detections / "recording.toml").is_file():
        found = load_recording(detections)
        begin = first_image()
        numbered = [
            {
                begin + int(slot): view
                for slot in found.views[found.rig.index(camera_id)].slots
                if (view := found.view(int(slot), found.rig.index(camera_id))) is not None
            }
            for camera_id in rig.camera_ids
        ]
        skeleton, detector = found.skeleton, found.detector
    else:
        skeleton, numbered = read_detections(detections, rig, folders, progress)
        detector = ""
    views = tuple(_series(camera, frames, fps, skeleton) for camera in numbered)
    if not any(len(series.slots) for series in views):
        raise InputError(
            f"{detections}: found no view of frames {frames[0]} to {frames[1]}, expected the "
            "numbers of the images"
        )
    return Detected(
        skeleton, views, f" 2D keypoints: {detections.name}, {skeleton.name}.", detector
    )


def _series(
    camera: Mapping[int, Poses2D], frames: tuple[int, int], fps: float, skeleton: Skeleton
) -> ViewSeries:
    first, last = frames
    numbers = sorted(number for number in camera if first <= number <= last)
    slots = [number - first for number in numbers]
    views = [camera[number] for number in numbers]
    return ViewSeries.from_views(views, slots, [slot / fps for slot in slots], len(skeleton))
