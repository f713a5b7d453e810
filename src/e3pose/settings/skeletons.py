"""The skeleton of a site: the configured one, or one that all its detectors support."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from e3pose.detectors import DETECTORS, skeleton_of
from e3pose.errors import InputError
from e3pose.model.skeleton import COCO17, Skeleton, lacking, skeleton_by_name
from e3pose.recording.folder import read_detector, read_skeleton
from e3pose.settings.site_file import DEFAULT_DETECTOR, CameraTable, SiteTable
from e3pose.settings.sources import is_recorded, place_of

Found = TypeVar("Found")


def detector_of(camera: CameraTable) -> str | None:
    """Return the detector of a camera; None where the site file does not say it.

    A camera that this machine runs has the default of `e3pose camera`.
    """
    runs_here = camera.source is not None and not is_recorded(camera.source)
    return camera.detector or (DEFAULT_DETECTOR if runs_here else None)


def camera_detector(site: SiteTable, camera: CameraTable) -> str | None:
    """Return the detector of a camera, of a recorded one that of its recording; None if unknown."""
    if camera.detector is None and is_recorded(camera.source or ""):
        return _of_recording(site, camera, read_detector) or None
    return detector_of(camera)


def camera_skeleton(site: SiteTable, camera: CameraTable) -> Skeleton | None:
    """Return what a camera's detector outputs; None where that shows only when it runs."""
    if is_recorded(camera.source or ""):
        return _of_recording(site, camera, read_skeleton)
    name = detector_of(camera)
    if name is None:
        return None
    model = None if camera.model is None else site.near(camera.model)
    try:
        own = name not in DETECTORS and site.near(name).exists()
        return skeleton_of(str(site.near(name)) if own else name, model)
    except (InputError, ImportError):  # an error of the camera, which runs it
        return None


def _of_recording(
    site: SiteTable, camera: CameraTable, read: Callable[[Path], Found]
) -> Found | None:
    """Return what is read of the recording that a camera plays; None where that fails."""
    try:
        return read(site.near(place_of(camera.source or "") or ""))
    except InputError:
        return None  # an error when the camera starts


def camera_skeletons(site: SiteTable, cameras: Mapping[str, CameraTable]) -> dict[str, Skeleton]:
    """Return what the detectors output, of those cameras of which it is known."""
    found = {name: camera_skeleton(site, camera) for name, camera in cameras.items()}
    return {name: skeleton for name, skeleton in found.items() if skeleton is not None}


def site_skeleton(asked: str | None, detectors: Iterable[Skeleton]) -> Skeleton:
    """Return the skeleton that a site works in.

    Args:
        asked: its name, if one is configured.
        detectors: what the cameras' detectors output.

    Returns:
        The one asked for; else the one that lacks fewest joints in any camera, and of several the
        one with fewest joints, as what a detector does not find is made of others.
    """
    if asked is not None:
        return skeleton_by_name(asked)
    known = list(dict.fromkeys(detectors))

    def cost(target: Skeleton) -> tuple[int, int]:
        return sum(len(lacking(other.joints, target.joints)) for other in known), len(target)

    return min(known, key=cost, default=COCO17)
