"""`e3pose top`: the status of a running site."""

from __future__ import annotations

import time
from pathlib import Path

from rich.console import Console
from rich.live import Live

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.screen import screen
from e3pose.site.stream_problems import problems_of


def top(
    site: Path,
    /,
    *,
    keys: Path | None = None,
    once: Flag = False,
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
                    f"endpoint {link.endpoint}: the edge of site {table.name} does not answer; "
                    "is it running? e3pose up or e3pose edge starts it"
                )
            console.print(screen(follower.status, 0.0, problems_of(table.path)))
            return
        came_s = time.monotonic()
        with Live(screen(None, 0.0), console=console, screen=True, auto_refresh=False) as live:
            while True:
                if follower.fresh.wait(1.0):
                    follower.fresh.clear()
                    came_s = time.monotonic()
                stale_s = time.monotonic() - came_s
                live.update(screen(follower.status, stale_s, problems_of(table.path)), refresh=True)
    except KeyboardInterrupt:
        pass
    finally:
        transport.close()
