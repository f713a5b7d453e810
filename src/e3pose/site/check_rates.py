"""Check that the sources of a site bring as many frames as it has slots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

from e3pose.base.errors import InputError
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.edge.delivery import SHORT
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.sources import is_recorded
from e3pose.site.check import Finding


def check_rates(site: ResolvedSite, progress: Callable[[int, int], None]) -> Iterator[Finding]:
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
            yield Finding("problem", f"camera {camera_id}", str(seen))
    found = {name: seen for name, seen in tried.items() if isinstance(seen, Probe)}
    yield from compare_rates(found, site.fps)


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
            yield Finding("ok", what, seen.rate_words())
            continue
        without = f"{1 - seen.fps / fps:.0%} of the slots ordered of it get no view"
        yield Finding(
            "problem",
            what,
            f"its source brings {seen.rate_words()}, the site has fps = {fps:g}: {without}",
            f"fps = {least:.3g} in the site file, or raise the camera's frame rate",
        )
