"""`e3pose edge`, `camera`, `up`: the live programs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_seconds, duration_s
from e3pose.cli.camera_options import CameraOptions
from e3pose.cli.options import Flag, as_typed, warn
from e3pose.cli.progress import LINE_S

if TYPE_CHECKING:
    from rich.console import Console

    from e3pose.site.follow import Follower
    from e3pose.site.up import Program
    from e3pose.wire.site_messages import Status

CAMERA = CameraOptions()
DELAY = {"smooth_delay_ms": "--delay"}
# For programs that start others: `site.up`.
Child = Annotated[bool, Parameter(negative="", show=False)]


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
    _begin(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.base.clock import WallClock
    from e3pose.settings.resolved import resolve_site
    from e3pose.site.edge_program import start_edge
    from e3pose.site.logs import open_log
    from e3pose.site.summary import edge_summary

    delay_ms = _delay_ms(delay)
    if len(site) > 1:
        from e3pose.site.many_edges import run_edges
        from e3pose.site.run import end_now

        with as_typed(DELAY):
            lines, all_ended = run_edges(
                site,
                lambda path: resolve_site(path, delay_ms),
                lambda path: open_log("edge", json_logs, site=str(path)),
                for_s,
            )
        print("\n".join(lines))
        if not all_ended:
            end_now()
        return
    with as_typed(DELAY):
        resolved = resolve_site(site[0], delay_ms)
    log = open_log("edge", json_logs, site=resolved.name)
    with start_edge(resolved, log, WallClock()) as opened:
        opened.run(for_s)
        counts = opened.server.counts
        print("\n".join(edge_summary(opened.status(), counts.slots, counts.views)))


def camera(
    config: Path | None = None,
    /,
    *,
    options: CameraOptions = CAMERA,
    json_logs: Flag = False,
    end_with_parent: Child = False,
) -> None:
    """Run one camera: capture, detect in selected slots, send keypoints.

    Example: `e3pose camera camera.toml`

    Without a file: `e3pose camera --site lab --name cam1 --source usb:0 --endpoint
    tls/edge.local:7447 --keys cam1`

    Images stay on the camera, except for small ones with `--pictures`. The program connects and
    reconnects to the edge by itself and runs the detector only in slots in which the camera is
    selected. Stop it with Ctrl-C.

    Parameters
    ----------
    config
        Camera file; the options below take precedence.
    json_logs
        Log as JSON, one object per line.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    _begin(end_with_parent)
    from e3pose.settings.camera_file import load_node
    from e3pose.site.camera_program import open_camera
    from e3pose.site.logs import open_log
    from e3pose.site.summary import camera_summary

    given, names = options.given(config)
    with as_typed(names):
        node = load_node(config, given)
        log = open_log("camera", json_logs, site=node.site, camera=node.camera)
        opened = open_camera(node, log)
    opened.run()
    made = opened.node
    print(
        camera_summary(
            node.camera, made.counts, made.schedule.orders, made.schedule.late, made.problem
        )
    )


def up(
    site: Path,
    /,
    *,
    example: Flag = False,
    view: Flag = False,
    delay: str | None = None,
    logs: Path | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    quiet: Flag = False,
) -> None:
    """Run a complete site on this machine: the edge and one process per camera.

    Example: `e3pose up try --example`

    That creates a simulated site in the folder `try` and runs it; `e3pose up site.toml` runs an
    existing site. Each `[[camera]]` of the site file needs a `source`. The screen is that of
    `e3pose top`; Ctrl-C stops everything.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    example
        Create the folder first, with four cameras that play a simulated scene.
    view
        Also run `e3pose view`: the live page, at the printed address.
    delay
        Publish poses a second time, smoothed, this much later, such as 200ms. Default:
        `smooth_delay_ms` of the site file.
    logs
        Folder for the logs of the programs. Default: `logs` beside the site file.
    for_s
        Stop after this many seconds.
    quiet
        Print nothing but the addresses of `--view`.
    """
    check_seconds("--for", for_s)
    from rich.console import Console

    from e3pose.base.private import make_folder
    from e3pose.settings.resolved import resolve_site
    from e3pose.site.example import make_example
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.site.ready import site_programs
    from e3pose.site.up import Program, view_command
    from e3pose.wire.network import open_network

    if example:
        make_example(site)
    delay_ms = _delay_ms(delay)
    with as_typed(DELAY):
        resolved = resolve_site(site, delay_ms)
    folder = logs or resolved.folder / "logs"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--logs: found a file, expected a folder: {folder}")
    options = () if delay is None else ("--delay", delay)
    measuring = Console(stderr=True).status("measuring the networks")
    programs = site_programs(resolved, folder, *options, warn=warn, measuring=measuring)
    console = Console(quiet=quiet)
    if view:
        from e3pose.site.web.program import address_of, page_links

        programs.append(Program("view", view_command(resolved.path), folder / "view.log"))
        address = address_of(resolved)
        print("\n".join(page_links(resolved, address)), flush=True)
    make_folder(folder)
    link = viewer_link(resolved, None)
    with closing(open_network(link)) as transport:
        follower = Follower(resolved.name)
        follower.listen(transport)
        _run_shown(programs, follower, console, for_s, show=console.is_terminal and not quiet)
    console.print(f"Stopped. Logs: {folder}", highlight=False)


def _run_shown(
    programs: Sequence[Program],
    follower: Follower,
    console: Console,
    for_s: float | None,
    show: bool,
) -> None:
    """Run the programs until stopped, and show the site: all the time, or once at the end."""
    from rich.live import Live

    from e3pose.site.screen import compiling_words, screen
    from e3pose.site.up import run_site

    begun_s = came_s = said_s = time.monotonic()
    end_s = None if for_s is None else begun_s + for_s
    newest: Status | None = None
    with Live(console=console, auto_refresh=False) if show else nullcontext() as live:

        def stopped() -> bool:
            nonlocal came_s, newest, said_s
            if follower.fresh.is_set():
                follower.fresh.clear()
                came_s, newest = time.monotonic(), follower.status
            if live is not None:
                live.update(screen(follower.status, time.monotonic() - came_s), refresh=True)
            rest_s = None if live is not None or newest is None else newest.compiling_s
            if rest_s is not None and time.monotonic() >= said_s:
                said_s = time.monotonic() + LINE_S
                console.print(compiling_words(rest_s), highlight=False)
            return end_s is not None and time.monotonic() >= end_s

        with suppress(KeyboardInterrupt):
            run_site(programs, stopped, console.print)
    if newest is not None and not show:  # of a site at work, not of one that is ending
        console.print(screen(newest, 0.0))


def _delay_ms(delay: str | None) -> float | None:
    """Return what `--delay` says."""
    if delay is None:
        return None
    with as_typed({"": "--delay"}):
        return 1e3 * duration_s(delay)


def _begin(end_with_parent: bool) -> None:
    """Prepare a program that runs for months."""
    from e3pose.site.interpreter import bound_heaps
    from e3pose.site.run import end_with_parent as look_after_parent

    bound_heaps()
    if end_with_parent:
        look_after_parent()
