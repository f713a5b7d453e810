"""`e3pose top` and `check`: status and configuration check of a site."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.text import Text

from e3pose.cli.options import warn
from e3pose.errors import InputError
from e3pose.plural import counted
from e3pose.quantities import check_seconds

if TYPE_CHECKING:
    from e3pose.settings.site_file import SiteTable
    from e3pose.site.check import Finding


def top(
    site: Path,
    /,
    *,
    keys: Path | None = None,
    once: Annotated[bool, Parameter(negative="")] = False,
    timeout: float = 5.0,
) -> None:
    """Show the live status of a running site: cameras, power, batteries, delays.

    Example: `e3pose top site.toml`

    Columns: mode; duty (share of the last minute's slots); power in watts and battery, ~ if
    modelled; deficit (energy queue, in slots); age of the last message; views late and lost; clock
    offset in ms (corrected); keypoint noise relative to its noise model. Narrow terminals show
    fewer columns. Ctrl-C quits.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    keys
        Folder from `e3pose keys add NAME --viewer`. Default on the edge server: the first viewer.
    once
        Print the status once and exit; exit code 2 if the edge does not answer.
    timeout
        With --once: seconds to wait for the edge.
    """
    check_seconds("--timeout", timeout)
    from rich.console import Console
    from rich.live import Live

    from e3pose.settings.site_file import load_site
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.site.screen import screen
    from e3pose.wire.network import open_network

    table = load_site(site)
    link = viewer_link(table, keys)
    transport = open_network(link)
    follower = Follower(table.name)
    follower.listen(transport)
    console = Console()
    try:
        if once:
            if not follower.fresh.wait(timeout):
                raise InputError(
                    f"endpoint {link.endpoint}: the edge of site {table.name} does not answer"
                )
            console.print(screen(follower.status, 0.0))
            return
        came_s = time.monotonic()
        with Live(screen(None, 0.0), console=console, screen=True, auto_refresh=False) as live:
            while True:
                if follower.fresh.wait(1.0):
                    follower.fresh.clear()
                    came_s = time.monotonic()
                live.update(screen(follower.status, time.monotonic() - came_s), refresh=True)
    except KeyboardInterrupt:
        pass
    finally:
        transport.close()


def check(site: Path, /, *, keys: Path | None = None, timeout: float = 2.0) -> None:
    """Check a site: calibration, certificates, networks, disks, clock, connected cameras.

    Example: `e3pose check site.toml`

    Each finding comes with the command or setting that fixes it. Exit code: 0 if ready, 1 if there
    are problems, 2 if the site file is invalid.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    keys
        Folder from `e3pose keys add NAME --viewer`.
    timeout
        Seconds to wait for the edge, if it runs.
    """
    check_seconds("--timeout", timeout)
    from rich.console import Console
    from rich.table import Table

    from e3pose.settings.site_file import load_site
    from e3pose.site import check as examine
    from e3pose.site.edge_program import check_edge

    table = load_site(site)
    live = check_edge(table)
    warn(live.world_warning())
    findings = [
        *examine.check_calibration(live.rig),
        *examine.check_link_of(table, live.rig),
        *examine.check_places(table),
        *examine.check_models(table, live.rig),
        examine.check_clock(),
        *_edge(table, keys, timeout),
    ]
    shown = Table(box=None, pad_edge=False, show_header=False)
    style = {"ok": "green", "warning": "yellow", "problem": "bold red"}
    for finding in findings:
        advice = f"\n-> {finding.advice}" if finding.advice else ""
        shown.add_row(
            Text(finding.level, style=style[finding.level]),
            Text(finding.what),
            Text(finding.found + advice),
        )
    Console().print(shown)
    count = {level: sum(finding.level == level for finding in findings) for level in style}
    told = f"{counted(count['problem'], 'problem')}, {counted(count['warning'], 'warning')}"
    if count["problem"]:
        print(f"e3pose: Not ready: {told}", file=sys.stderr)
        sys.exit(1)
    print(f"Ready: {told}")


def _edge(site: SiteTable, keys: Path | None, timeout_s: float) -> list[Finding]:
    from e3pose.site.check import Finding, check_running
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.wire.network import open_network

    try:
        link = viewer_link(site, keys)
        transport = open_network(link)
    except InputError as error:
        return [Finding("warning", "edge", f"cannot connect: {error}")]
    follower = Follower(site.name)
    follower.listen(transport)
    follower.fresh.wait(timeout_s)
    transport.close()
    return [*check_running(follower.status, link.endpoint)]
