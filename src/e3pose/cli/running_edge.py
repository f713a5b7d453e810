"""`e3pose edge`: the edge server of a site, or of several."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.clock import WallClock
from e3pose.base.errors import Exit
from e3pose.base.log_stream import drain
from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag, as_typed
from e3pose.cli.running import DELAY, Child, begin, delay_ms
from e3pose.settings.resolved import resolve_site
from e3pose.site.summary import edge_summary


def edge(
    site: Annotated[list[Path], Parameter(negative="")],
    /,
    *,
    delay: str | None = None,
    json_logs: Flag = False,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    end_with_parent: Child = False,
) -> None:
    """Run the edge server of a site: receive views, estimate poses, select cameras.

    Example: `e3pose edge site.toml`

    Example: `e3pose edge house/lab house/hall`, several sites in one process

    The edge waits for cameras, closes a slot when all views have arrived or its deadline has
    passed, and publishes the poses of each slot. Ctrl-C stops it with a summary; a restart resumes
    from the saved state. Watch it with `e3pose top site.toml`.

    Several sites share processor time and nothing else: each has its name, port, keys, state and
    folders. One that fails is started again by itself, after 2 s and then less and less often;
    one that is too slow loses slots of its own.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml; several for several sites.
    delay
        Publish poses a second time, smoothed, this much later, such as 200ms. Default:
        `smooth_delay_ms` of the site file.
    json_logs
        Log as JSON, one object per line.
    for_s
        Stop after this many seconds.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    begin(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.site.edge_program import start_edge
    from e3pose.site.logs import open_log

    later_ms = delay_ms(delay)
    if len(site) > 1:
        from e3pose.site.many_edges import run_edges

        with as_typed(DELAY):
            lines, all_ended = run_edges(
                site,
                lambda path: resolve_site(path, later_ms),
                lambda path: open_log("edge", json_logs, site=str(path)),
                for_s,
            )
        print("\n".join(lines))
        if not all_ended:  # nobody waits for threads that do not end
            drain()
            os._exit(Exit.DONE)
        return
    with as_typed(DELAY):
        resolved = resolve_site(site[0], later_ms)
    log = open_log("edge", json_logs, site=resolved.file.name)
    with start_edge(resolved, log, WallClock()) as opened:
        opened.run(for_s)
        counts = opened.server.counts
        print("\n".join(edge_summary(opened.status(), counts.slots, counts.views)))
