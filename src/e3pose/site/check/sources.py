"""Problems of this machine's cameras: sources, networks and frame rates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.masking import has_secret
from e3pose.base.plugins import is_own
from e3pose.camera.phone_file import load_phone
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.camera.source import open_video
from e3pose.camera.webcam import crowded_hubs, device_of
from e3pose.detectors import DETECTORS
from e3pose.detectors.weights import is_installed, networks
from e3pose.edge.camera_state import SHORT
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import CameraTable
from e3pose.settings.sources import PHONE, SECRET, detects, is_recorded, place_of, revealed
from e3pose.site.check.finding import Finding, ok, problem, warning

SOURCE_ADVICE = "correct its source, relative to the folder of the site file"


def source_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield the problems of sources and networks of cameras that `e3pose up` would run here."""
    for camera in site.cameras.values():
        yield from _recording(camera)
        if camera.source is None:
            if degrees := camera.rotation:
                found = f"rotation = {degrees}: it turns its images on its own machine"
                advice = f"rotation = {degrees} in its camera file"
                yield warning(f"camera {camera.id}", found, advice)
            continue
        yield from _source(camera, camera.source, site.file.path)
        if not detects(camera.source):
            yield from _network(camera)


def rate_problems(site: ResolvedSite, progress: Callable[[int, int], None]) -> Iterator[Finding]:
    """Count the frames of the cameras that `e3pose up` would run here; takes three seconds.

    Args:
        site: what its file says; it must not be running, or it has the devices.
        progress: called with cameras done, and how many there are.
    """
    asked = {
        camera_id: partial(probe, camera.source, camera_id)
        for camera_id, camera in site.cameras.items()
        if camera.source is not None and not is_recorded(camera.source)
    }
    tried = probe_all(asked, progress)
    for camera_id, seen in tried.items():
        if isinstance(seen, InputError):
            yield problem(f"camera {camera_id}", str(seen))
    found = {name: seen for name, seen in tried.items() if isinstance(seen, Probe)}
    yield from compare_rates(found, site.file.fps)


def hub_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield webcams of `e3pose up` that share a hub which cannot carry all of them."""
    asked = {
        name: (camera.source or "", camera.size, None) for name, camera in site.cameras.items()
    }
    for crowd, found in crowded_hubs(asked):
        yield warning(f"cameras {', '.join(crowd)}", found)


def compare_rates(found: Mapping[str, Probe], fps: float) -> Iterator[Finding]:
    """Compare the frames that sources bring with the slots of a site.

    Args:
        found: by camera, what its source brings.
        fps: slots per second of the site.
    """
    least = min((seen.fps for seen in found.values()), default=fps)
    for camera_id, seen in found.items():
        what = f"camera {camera_id}"
        if seen.fps >= SHORT * fps:
            yield ok(what, seen.rate_words())
            continue
        without = f"{1 - seen.fps / fps:.0%} of the slots ordered of it get no view"
        yield problem(
            what,
            f"its source brings {seen.rate_words()}, the site has fps = {fps:g}: {without}",
            f"fps = {least:.3g} in the site file, or raise the camera's frame rate",
        )


def _recording(camera: CameraTable) -> Iterator[Finding]:
    """Check whether the videos that are asked for can be recorded."""
    if camera.record not in ("video", "both"):
        return
    what = f"camera {camera.id}"
    if camera.source is None:
        found = f"record = {camera.record!r}: videos stay on its own machine"
        yield warning(what, found, 'videos = "videos" in its camera file')
    elif is_recorded(camera.source):
        found = f"record = {camera.record!r}, but its source has keypoints, no images"
        yield problem(what, found, 'record = "keypoints"')


def _source(camera: CameraTable, source: str, file: Path) -> Iterator[Finding]:
    """Check whether a source exists, without opening it."""
    what, place = f"camera {camera.id}", place_of(source)
    yield from password_problems(what, source, file)
    path = None if place is None else Path(place)
    if path is not None and not path.exists():
        yield problem(what, f"source {path} does not exist", SOURCE_ADVICE)
    elif path is not None and not is_recorded(source) and (broken := _broken(path, source)):
        yield problem(what, broken)
    elif source.startswith("usb:"):
        try:
            device_of(source.removeprefix("usb:"))
        except InputError as error:
            yield problem(what, str(error), "connect the camera")


def password_problems(what: str, source: str, file: Path) -> Iterator[Finding]:
    """Yield that a settings file has a password of a camera, and how to move it.

    Args:
        what: the camera.
        source: what the file says of it.
        file: of the settings.
    """
    if not has_secret(source):
        return
    readable = bool(file.stat().st_mode & 0o044)
    found = f"its password is in {file}{', which others can read' if readable else ''}"
    move = 'put the address into a file, chmod 600 it, and write source = "secret:FILE"'
    yield warning(what, found, f"{move}{f'; until then, chmod 600 {file}' if readable else ''}")


def _network(camera: CameraTable) -> Iterator[Finding]:
    """Check whether the network that a camera detects with is installed."""
    what, detector = f"camera {camera.id}", camera.detector or ""
    if camera.model is not None:
        if not camera.model.exists():
            yield problem(what, f"model {camera.model} does not exist")
    elif detector in (known := networks()) and not is_installed(detector):
        advice = f"e3pose models pull {detector}"
        yield problem(what, f"network {detector} is not installed", advice)
    elif not ({detector} & {*known, *DETECTORS} or is_own(detector) or Path(detector).exists()):
        listed = ", ".join(dict.fromkeys([*DETECTORS, *known]))
        yield problem(what, f"unknown detector {detector}", f"one of {listed}")


def _broken(path: Path, source: str) -> str:
    """Return why a video, or the file of a phone or an address, is unusable; empty if it is not."""
    if path.is_dir():
        return ""
    try:
        if source.startswith(SECRET):
            revealed(source)
        else:
            load_phone(path) if source.startswith(PHONE) else open_video(path)
    except InputError as error:
        return str(error)
    return ""
