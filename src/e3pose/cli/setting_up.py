"""`e3pose setup`: a page that leads from cameras to live 3D."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.quantities import check_seconds
from e3pose.base.system import open_browser
from e3pose.cli.options import Flag
from e3pose.cli.running import begin


def setup(
    site: Path | None = None,
    /,
    *,
    listen: str | None = None,
    no_browser: Flag = False,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
) -> None:
    """Set up a site in the browser: cameras, network, walk, calibration, check, live.

    Example: `e3pose setup room`

    The page is on loopback, behind the token in the printed address. Each step shows the command
    line that does the same, writes the same files, and goes on where it was after a reload or a
    restart. A site that exists opens with its settings. Ctrl-C ends the page, and the site if the
    page started it.

    Parameters
    ----------
    site
        Folder of the site, there or to be made. Default: choose on the page, among those in the
        current folder, in which films are looked for too.
    listen
        HOST:PORT of loopback. Default: 127.0.0.1:8471.
    no_browser
        Open no browser: print the address only.
    for_s
        Stop after this many seconds.
    """
    begin()
    check_seconds("--for", for_s)
    from e3pose.site.setup.program import open_setup

    with open_setup(site, listen) as opened:
        print(f"Set up a site: {opened.url}\nCtrl-C ends it.", flush=True)
        if not no_browser:
            open_browser(opened.url)
        opened.run(for_s)
