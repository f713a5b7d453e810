"""`e3pose cameras`: all cameras of a machine in one program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag
from e3pose.cli.running import Child, begin
from e3pose.site.summary import camera_summary


def cameras(
    file: Path,
    /,
    *files: Path,
    only: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    json_logs: Flag = False,
    end_with_parent: Child = False,
) -> None:
    """Run all cameras of this machine in one program, with one copy of the network.

    Example: `e3pose cameras site.toml`, or `e3pose cameras cam1.toml cam2.toml`

    Four webcams on a laptop, or eight streams on a computer with a GPU: the network is loaded once,
    and as many cameras look at a time as there are cores. A camera that fails is opened again by
    itself, while the others go on. `e3pose up --together` runs the cameras of a site in this way.

    Parameters
    ----------
    file
        Site file, for its cameras that have a `source`; or the file of a camera.
    files
        Files of further cameras.
    only
        Names of the cameras to run. Default: all.
    for_s
        Stop after this many seconds.
    json_logs
        Log as JSON, one object per line.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    begin(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.site.logs import open_log
    from e3pose.site.many_cameras import Cameras, nodes_of

    opened = Cameras(
        nodes_of((file, *files), only),
        lambda node: open_log("camera", json_logs, site=node.site, camera=node.camera),
    )
    opened.run(for_s)
    for _, made in sorted(opened.ended.items()):
        orders = made.schedule.orders, made.schedule.late
        print(camera_summary(made.settings.camera_id, made.counts, *orders, made.problem))
