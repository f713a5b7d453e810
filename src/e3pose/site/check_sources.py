"""Check what the cameras of a site see, and with which networks, where they run on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from e3pose.errors import InputError
from e3pose.geometry.camera import Rig
from e3pose.runtime.plugins import is_own
from e3pose.settings.site_file import DEFAULT_DETECTOR, SiteTable
from e3pose.site.check import Finding


def require_sources(site: SiteTable, rig: Rig) -> None:
    """Raise `InputError` for a source or network that is not there, with what helps."""
    for finding in check_sources(site, rig):
        if finding.level == "problem":
            advice = f": {finding.advice}" if finding.advice else ""
            raise InputError(f"{site.path}: {finding.what}: {finding.found}{advice}")


def check_sources(site: SiteTable, rig: Rig) -> Iterator[Finding]:
    """Look at the sources and networks of cameras that `e3pose up` would run here."""
    from e3pose.detectors import DETECTORS
    from e3pose.detectors.weights import MODELS, is_installed

    for camera in site.cameras_of(rig).values():
        what, filmed = f"camera {camera.id}", camera.record in ("video", "both")
        if camera.source is None:
            if filmed:
                found = f"record = {camera.record!r}: videos stay on its own machine"
                yield Finding("warning", what, found, 'videos = "videos" in its camera file')
            continue
        kind = camera.source.partition(":")[0]
        recorded = kind == "recorded"
        if recorded and filmed:
            found = f"record = {camera.record!r}, but its source has keypoints, no images"
            yield Finding("problem", what, found, 'record = "keypoints"')
        local = recorded or ("://" not in camera.source and kind not in ("usb", "gstreamer"))
        name = camera.source.partition(":")[2] if recorded else camera.source
        if local and not site.near(name).exists():
            yield Finding("problem", what, f"source {site.near(name)} does not exist")
        elif local and not recorded and (broken := _broken(site.near(name))):
            yield Finding("problem", what, broken)
        elif kind == "usb" and not Path(f"/dev/video{name.partition(':')[2]}").exists():
            yield Finding("problem", what, f"{camera.source}: no such device", "connect the camera")
        else:
            yield Finding("ok", what, f"source {camera.source[:60]}")
        if recorded:
            continue
        detector = camera.detector or DEFAULT_DETECTOR
        if camera.model is not None:
            if not site.near(camera.model).exists():
                yield Finding("problem", what, f"model {site.near(camera.model)} does not exist")
        elif detector in MODELS and not is_installed(detector):
            advice = f"e3pose models pull {detector}"
            yield Finding("problem", what, f"network {detector} is not installed", advice)
        elif not (detector in DETECTORS or is_own(detector) or site.near(detector).exists()):
            known = ", ".join(DETECTORS)
            yield Finding("problem", what, f"unknown detector {detector}", f"one of {known}")


def _broken(path: Path) -> str:
    """Return what keeps a film from being played; empty if nothing."""
    from e3pose.camera.source import open_video

    if path.is_dir():
        return ""
    try:
        open_video(path)
    except InputError as error:
        return str(error)
    return ""
