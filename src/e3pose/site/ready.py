"""Prepare a site to run on this machine: check it, and list its programs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.admission import edge_link
from e3pose.site.check.finding import report
from e3pose.site.check.parts import start_problems
from e3pose.site.check.sources import source_problems
from e3pose.site.detector_speed import measure_detections, speed_problems
from e3pose.site.edge_program import check_edge
from e3pose.site.up import Program, Role, camera_program, cameras_program, edge_command
from e3pose.wire.network import check_port


def site_programs(
    site: ResolvedSite,
    logs: Path,
    *options: str,
    warn: Callable[[str], object],
    together: bool = False,
    measuring: AbstractContextManager[object] | None = None,
) -> list[Program]:
    """Return the checked programs of a site: the edge, then the cameras.

    Args:
        site: what its file says.
        logs: folder of their logs.
        options: further ones of the edge.
        warn: called with what is odd, in words.
        together: whether all cameras share one program, and one copy of the network.
        measuring: entered while networks are measured.

    Raises:
        InputError: for what keeps the site from running, so that it stands in no log alone.
    """
    findings = list(source_problems(site))
    left_out = {finding.what for finding in findings if finding.level == "problem"}
    # A camera that is not there yet keeps no other from its work.
    report(findings, warn, str(site.file.path) if len(left_out) == len(site.cameras) else "")
    check_edge(site)
    link, _ = edge_link(site.file)
    check_port(link.endpoint)
    report(start_problems(site), warn)
    with measuring or nullcontext():
        try:
            away = [name for name in site.cameras if f"camera {name}" in left_out]
            times = measure_detections(site, again=False, without=away)
        except InputError as error:  # a camera's own program says so too
            times = None
            warn(f"the time of detections is not known: {error}")
    if times is not None:
        selected = site.loop.num_selected or len(site.rig)
        report(speed_problems(site.file, times, selected), warn, str(site.file.path))
    edge = Program("edge", edge_command(site.file.path, *options), logs / "edge.log")
    cameras = [cameras_program(site, logs)]
    if not together:
        cameras = [camera_program(site, camera_id, logs) for camera_id in site.cameras]
    return [edge, *(replace(camera, role=Role.CAMERA) for camera in cameras)]
