"""`e3pose router`: a router before the edge of a site."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag
from e3pose.cli.running import begin
from e3pose.site.router_program import Router
from e3pose.site.run import run_until_stopped
from e3pose.wire.endpoint import read_endpoint


def router(
    keys: Path,
    /,
    *,
    edge: str,
    endpoint: str = "tls/0.0.0.0:7447",
    json_logs: Flag = False,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
) -> None:
    """Run a router that connects the cameras of another network to the edge.

    Example: `e3pose router hall --edge tls/edge.local:7447`

    Cameras and viewers connect to the router as they would to the edge, with the same permissions.
    After each change of certificates, copy keys.toml to the router's folder; it reloads within
    seconds. Stop it with Ctrl-C.

    Parameters
    ----------
    keys
        Folder from `e3pose keys add NAME --router`.
    edge
        Endpoint of the edge, tls/HOST:PORT.
    endpoint
        Endpoint to listen on.
    json_logs
        Log as JSON, one object per line.
    for_s
        Stop after this many seconds.
    """
    begin()
    check_seconds("--for", for_s)
    from e3pose.site.logs import open_log
    from e3pose.wire.network import open_network

    log = open_log("router", json_logs)
    made = Router(
        keys,
        read_endpoint(endpoint, "--endpoint"),
        read_endpoint(edge, "--edge"),
        open_network,
        log.info,
    )

    def running() -> bool:
        made.update()
        return True

    made.open()
    try:
        log.info("router ready", site=made.site, endpoint=endpoint, edge=edge)
        run_until_stopped(running, for_s)
    finally:
        made.close()
