"""`e3pose check`: check a site, or the machine of one camera, before it runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from e3pose.base.errors import Exit
from e3pose.base.quantities import check_seconds, plural
from e3pose.cli.options import Flag
from e3pose.cli.progress import bar
from e3pose.settings.camera_file import is_camera_file, load_node
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import load_site
from e3pose.site.check.finding import Finding

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

    Checks of a site: calibration (also against stored or recorded people), skeletons, budgets,
    certificates, frame rates of the sources, speed of the networks, disks, clock, connected
    cameras. Checks of a camera: source, network, clock, certificate, and the route to the edge.
    Each finding comes with the command or setting that fixes it. Exit code: 0 if ready,
    1 if there are problems, 2 if the file is invalid.

    Parameters
    ----------
    site
        Site file, the folder that contains site.toml, or a camera file.
    keys
        Folder from `e3pose keys add NAME --viewer`.
    timeout
        Seconds to wait for the edge, if it runs.
    quick
        Do not measure the speed of the networks and the frame rates.
    """
    check_seconds("--timeout", timeout)
    if is_camera_file(site):
        from e3pose.site.check.camera import check_camera

        found = check_camera(load_node(site), timeout)
    else:
        from e3pose.site.check.site import examine_site

        resolved = resolve(load_site(site), placed=False)
        measuring = Console(stderr=True).status("measuring the networks")
        found = examine_site(resolved, keys, timeout, bar("counting frames"), measuring, quick)
    _show(found)


def _show(findings: Sequence[Finding]) -> None:
    """Print the findings; exit with 1 if there is a problem."""
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
        sys.exit(Exit.NO)
    print(f"Ready: {summary}")
