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
    """Set up a site in the browser: cameras, calibration, live.

    Example: `e3pose setup room`

    Only this machine can open the page, by the printed address. Each step shows the command that
    does the same, writes the same files, and continues after a reload or a restart. An existing
    site opens with its settings. Ctrl-C ends the page, and the site if the page started it.

    Parameters
    ----------
    site
        Folder of the site, new or existing. Default: choose one on the page. Films are searched
        below the current folder.
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
