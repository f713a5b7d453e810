"""`e3pose top`: a running site in the terminal."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.errors import InputError


def top(
    site: Path,
    /,
    *,
    keys: Path | None = None,
    once: Annotated[bool, Parameter(negative="")] = False,
    timeout: float = 5.0,
) -> None:
    """Show a running site: cameras, modes, batteries, watts, who is there.

    Example: `e3pose top site.toml`

    A mark ~ before the watts means that a model says them, not a measurement.

    Parameters
    ----------
    site
        The site file.
    keys
        The folder that `e3pose keys add NAME --viewer` made; on the edge server the first viewer of
        the site's keys by default.
    once
        Print the state once, and end; exit code 2 when no edge answers.
    timeout
        Seconds to wait for the edge with --once.
    """
    from rich.console import Console
    from rich.live import Live

    from e3pose.site.config import load_site
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.site.screen import screen
    from e3pose.wire.network import open_network

    table = load_site(site)
    link = viewer_link(site, table, keys)
    transport = open_network(link)
    follower = Follower(table.name)
    follower.listen(transport)
    console = Console()
    try:
        if once:
            if not follower.fresh.wait(timeout):
                raise InputError(f"endpoint {link.endpoint}: no edge of site {table.name} answers")
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
