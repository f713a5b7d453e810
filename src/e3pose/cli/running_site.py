"""`e3pose up`: all programs of a site on one machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live

from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag, as_typed, warn
from e3pose.cli.progress import LINE_S
from e3pose.cli.running import DELAY, begin, delay_ms
from e3pose.settings.resolved import resolve_site
from e3pose.site.example import make_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.screen import compiling_words, screen
from e3pose.site.up import Program, run_site
from e3pose.site.web.address import page_links, view_program

if TYPE_CHECKING:
    from e3pose.settings.resolved import ResolvedSite
    from e3pose.wire.site_messages import Status


def up(
    site: Path,
    /,
    *,
    example: Flag = False,
    view: Flag = False,
    together: Flag = False,
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
        Also run `e3pose view`: the live page, at the printed address. Its port is that of the site
        file; by default 8470, or the next free one.
    together
        Run all cameras in one program with one copy of the network, as `e3pose cameras` does, which
        saves memory.
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
    begin()
    check_seconds("--for", for_s)
    from e3pose.site.ready import site_programs

    if example:
        make_example(site)
    later_ms = delay_ms(delay)
    with as_typed(DELAY):
        resolved = resolve_site(site, later_ms)
    folder = logs or resolved.file.folder / "logs"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--logs: found a file, expected a folder: {folder}")
    page = None
    if view:
        page, address = view_program(resolved, folder, warn)  # first: a port is found at once
    options = () if delay is None else ("--delay", delay)
    measuring = Console(stderr=True).status("measuring the networks")
    console = Console(quiet=quiet)
    heard = (lambda _: None) if quiet else warn  # the log of the edge has its warnings
    programs = site_programs(
        resolved, folder, *options, warn=heard, together=together, measuring=measuring
    )
    if page is not None:
        programs.append(page)
        print("\n".join(page_links(resolved.file, address)), flush=True)
    end_s = float("inf") if for_s is None else time.monotonic() + for_s
    with suppress(KeyboardInterrupt):
        run_shown(resolved, programs, folder, console, lambda _: end_s <= time.monotonic())
    console.print(f"Stopped. Logs: {folder}", highlight=False)


def run_shown(
    site: ResolvedSite,
    programs: Sequence[Program],
    logs: Path,
    console: Console,
    over: Callable[[Status | None], bool],
) -> Status | None:
    """Run the programs of a site, and show it: all the time, or once at the end; return its status.

    Args:
        site: what its file says.
        programs: of the site.
        logs: folder of their logs, which is made.
        console: where to show it.
        over: called often with the newest status; True ends the programs, as Ctrl-C does.
    """
    from e3pose.wire.network import open_network

    with suppress(OSError):  # programs then say that they run without logs
        make_folder(logs)
    show = console.is_terminal and not console.quiet
    came_s = said_s = time.monotonic()
    newest: Status | None = None
    follower = Follower(site.file.name)
    with (
        closing(open_network(viewer_link(site.file, None))) as transport,
        Live(console=console, auto_refresh=False) if show else nullcontext() as live,
    ):
        follower.listen(transport)

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
            return over(newest)

        try:
            run_site(programs, stopped, console.print)
        finally:
            if newest is not None and not show:  # of a site at work, not of one that is ending
                console.print(screen(newest, 0.0))
    return newest
