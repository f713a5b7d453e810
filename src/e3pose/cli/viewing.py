"""`e3pose view`: the live page, API and streams of a running site."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.quantities import check_seconds
from e3pose.cli.options import warn
from e3pose.cli.running import Child, begin
from e3pose.settings.resolved import resolve_site
from e3pose.site.run import reduce_pauses
from e3pose.site.web.address import page_links


def view(
    site: Path,
    /,
    *,
    listen: str | None = None,
    keys: Path | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    handle: Annotated[int | None, Parameter(name="--socket", show=False)] = None,
    end_with_parent: Child = False,
) -> None:
    """Serve the live page, API and streams of a running site over HTTP.

    Example: `e3pose view site.toml`, then open the printed address in a browser.

    On loopback everyone on this machine may read; beyond it, reading needs the token that is part
    of the printed address. The second address also controls the site. Ctrl-C stops it.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    listen
        HOST:PORT instead of the site file's. Default: 127.0.0.1:8470, or the next free port.
    keys
        Folder from `e3pose keys add NAME --operator`, or `--viewer` to read only. Default on the
        edge server: the first operator, else the first viewer.
    for_s
        Stop after this many seconds.
    handle
        Serve at this open socket, which the parent process has.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    check_seconds("--for", for_s)
    from e3pose.site.web.program import open_view

    begin(end_with_parent)
    resolved = resolve_site(site)
    with open_view(resolved, listen, keys, report=warn, handle=handle) as opened:
        # A parent shows the links itself: its log keeps no token.
        links = (
            [opened.address.url] if end_with_parent else page_links(resolved.file, opened.address)
        )
        print("\n".join(links), flush=True)
        reduce_pauses()
        opened.run(for_s)
