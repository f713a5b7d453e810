"""`e3pose check`: check a site, or the machine of one camera, before it runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_seconds, plural
from e3pose.cli.options import Flag, warn
from e3pose.cli.progress import stage_progress
from e3pose.settings.camera_file import is_camera_file, load_node
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import load_site
from e3pose.site import check as examine
from e3pose.site.check import Finding, check_running
from e3pose.site.check.sources import check_rates, check_sources
from e3pose.site.detector_speed import check_speed, measure_detections
from e3pose.site.follow import Follower, viewer_link

if TYPE_CHECKING:
    from e3pose.settings.resolved import ResolvedSite

STYLES = {"ok": "green", "warning": "yellow", "problem": "bold red"}


def check(
    site: Path,
    /,
    *,
    keys: Path | None = None,
    timeout: float = 2.0,
    quick: Flag = False,
) -> None:
    """Check a site, or the machine of one camera, before it runs.

    Example: `e3pose check site.toml`, and on a camera `e3pose check camera.toml`

    Of a site: calibration, skeletons, budgets, certificates, the frames that sources bring,
    networks and how long they take here, disks, clock, connected cameras. Of a camera: source,
    network, clock, certificate, and the route to the edge. Each finding comes with the command or
    setting that fixes it. Exit code: 0 if ready, 1 if there are problems, 2 if the file is invalid.

    Parameters
    ----------
    site
        Site file, the folder that contains site.toml, or a camera file.
    keys
        Folder from `e3pose keys add NAME --viewer`.
    timeout
        Seconds to wait for the edge, if it runs.
    quick
        Do not measure how long the networks take, nor count frames.
    """
    check_seconds("--timeout", timeout)

    if is_camera_file(site):
        from e3pose.site.check.camera import check_camera

        node = load_node(site)
        found = list(check_camera(node, timeout))
    else:
        table = load_site(site)
        resolved = resolve(table, placed=False)
        edge, running = _edge(resolved, keys, timeout)
        found = [*_site(resolved, quick, running), *edge]
    _show(found)


def _site(site: ResolvedSite, quick: bool, running: bool) -> list[Finding]:
    from e3pose.site.check import settings as check_settings
    from e3pose.site.edge_program import check_edge

    if not site.rig.placed:
        found = [examine.uncalibrated(site)]
    else:
        parts = check_edge(site)
        warn(site.warning)
        now = datetime.now().astimezone()
        found = [
            *examine.check_calibration(site.rig),
            *check_settings.check_skeletons(site),
            *check_settings.check_feedback(site),
            *check_settings.check_events(site),
            *check_settings.check_budgets(site, parts, now),
        ]
    sources = list(check_sources(site))
    found += [*examine.check_link_of(site), *examine.check_places(site), *sources]
    usable = all(finding.level != "problem" for finding in sources)
    selected = min(site.loop.num_selected or len(site.rig), len(site.rig))
    if usable and not quick:
        if not running:  # a running site has the devices, and counts their frames itself
            with stage_progress() as (_, advance):
                found += check_rates(site, partial(advance, "counting frames"))
        found += _looks(site, selected)
    return [*found, examine.check_clock(site.link.endpoint)]


def _looks(site: ResolvedSite, selected: float) -> list[Finding]:
    try:
        with Console(stderr=True).status("measuring the networks"):
            times = measure_detections(site)
    except InputError as error:
        return [Finding("problem", "network", str(error))]
    return [] if times is None else list(check_speed(site, times, selected))


def _edge(site: ResolvedSite, keys: Path | None, timeout_s: float) -> tuple[list[Finding], bool]:
    """Return what is found of the edge, and whether it is running."""
    from e3pose.wire.network import open_network

    try:
        link = viewer_link(site, keys)
        transport = open_network(link)
    except InputError as error:
        return [Finding("warning", "edge", f"cannot connect: {error}")], False
    follower = Follower(site.name)
    follower.listen(transport)
    follower.fresh.wait(timeout_s)
    transport.close()
    running = follower.status is not None
    return [*check_running(follower.status, link.endpoint)], running


def _show(findings: Sequence[Finding]) -> None:
    """Print what was found; exit with 1 if there is a problem."""
    shown = Table(box=None, pad_edge=False, show_header=False)
    for finding in findings:
        advice = f"\n-> {finding.advice}" if finding.advice else ""
        shown.add_row(
            Text(finding.level, style=STYLES[finding.level]),
            Text(finding.what),
            Text(finding.found + advice),
        )
    Console().print(shown)
    count = {level: sum(finding.level == level for finding in findings) for level in STYLES}
    summary = f"{plural(count['problem'], 'problem')}, {plural(count['warning'], 'warning')}"
    if count["problem"]:
        print(f"e3pose: Not ready: {summary}", file=sys.stderr)
        sys.exit(1)
    print(f"Ready: {summary}")
