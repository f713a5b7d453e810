"""`e3pose edge`, `camera`, `up`: a site at work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from e3pose.cli.options import Whole, as_typed, warn
from e3pose.errors import MISSING, InputError
from e3pose.quantities import check_seconds

# For programs that start others: `site.up`.
Child = Annotated[bool, Parameter(negative="", show=False)]


def edge(
    site: Path,
    /,
    *,
    json_logs: Annotated[bool, Parameter(negative="")] = False,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    end_with_parent: Child = False,
) -> None:
    """Run the edge server of a site: receive, fuse, choose cameras, tell them.

    Examples: `e3pose edge site.toml`, `e3pose edge lab` where that is a folder with a site.toml

    Waits until the cameras are there, closes a slot when all views are in or its deadline passes,
    and publishes the people of every slot. Ends on Ctrl-C with a summary; started again it goes on
    where it was. Look at it with `e3pose top site.toml`. docs/live.md has the whole story.

    Parameters
    ----------
    site
        The site file, or the folder that has it as site.toml.
    json_logs
        Log one JSON object a line.
    for_s
        End by itself after so many seconds.
    end_with_parent
        End when standard input ends, a pipe from the program that started this one.
    """
    _look_after_parent(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.settings.site_file import load_site
    from e3pose.site.edge_program import open_edge
    from e3pose.site.logs import open_log
    from e3pose.site.summary import edge_summary

    table = load_site(site)
    with open_edge(table, open_log("edge", json_logs, site=table.name)) as opened:
        opened.run(for_s)
        counts = opened.server.counts
        print("\n".join(edge_summary(opened.status(), counts.slots, counts.views)))


def camera(
    config: Path | None = None,
    /,
    *,
    site: str | None = None,
    name: str | None = None,
    source: str | None = None,
    endpoint: str | None = None,
    keys: str | None = None,
    detector: str | None = None,
    model: str | None = None,
    provider: str | None = None,
    threads: Whole | None = None,
    fps: float | None = None,
    pace: float | None = None,
    begin_s: float | None = None,
    wake_s: float | None = None,
    battery_wh: float | None = None,
    meter: str | None = None,
    profile: str | None = None,
    state: str | None = None,
    insecure: Annotated[bool | None, Parameter(negative="")] = None,
    json_logs: Annotated[bool, Parameter(negative="")] = False,
    end_with_parent: Child = False,
) -> None:
    """Run one camera: capture, detect when told to, send keypoints.

    Examples: `e3pose camera camera.toml`,
    `e3pose camera --site lab --name cam1 --source usb:0 --endpoint tls/edge.local:7447 --keys cam1`

    Images never leave the camera. It finds the edge by itself, also when that comes later or comes
    back, and looks only in slots for which it was told to. Ends on Ctrl-C.

    Parameters
    ----------
    config
        A camera file; the options below take precedence.
    site
        Name of the site.
    name
        Name of the camera in the site's calibration.
    source
        usb:0, rtsp://..., gstreamer:PIPELINE, a video, a folder of images, recorded:RECORDING.
    endpoint
        Where the edge listens: tls/HOST:PORT, or tcp/HOST:PORT on the same machine.
    keys
        The folder that `e3pose keys add` made for this camera.
    detector
        Name of the network, see `e3pose models list`.
    model
        File of the network.
    provider
        Where it runs: auto, tensorrt, cuda, cpu.
    threads
        Processor threads of the network; all cores by default.
    fps
        Frames a second to ask of the source.
    pace
        How fast a file or recording is played, 1 by default; the site's own `pace`.
    begin_s
        When a file or recording begins, seconds since 1970; nothing is shown before. By default
        its rounds are counted from 1970, so that all cameras show the same moment.
    wake_s
        Seconds from aggressive power-saving to the first frame.
    battery_wh
        Capacity of the battery; without it the camera is on mains.
    meter
        How power is measured: auto, or model for the profile's figures.
    profile
        Power profile for what is not measured.
    state
        File that remembers the charge of a battery without a gauge; beside the camera file by
        default, as NAME.battery.json. Delete it when the battery is full again.
    insecure
        Allow plain tcp beyond this machine.
    json_logs
        Log one JSON object a line.
    end_with_parent
        End when standard input ends, a pipe from the program that started this one.
    """
    _look_after_parent(end_with_parent)
    from e3pose.settings.camera_file import load_node
    from e3pose.site.camera_program import open_camera
    from e3pose.site.logs import open_log
    from e3pose.site.summary import camera_summary

    given = {
        "site": site, "camera": name, "source": source, "endpoint": endpoint, "keys": keys,
        "detector": detector, "model": model, "provider": provider, "threads": threads,
        "fps": fps, "pace": pace, "begin_s": begin_s, "wake_s": wake_s,
        "battery_wh": battery_wh, "meter": meter, "profile": profile, "state": state,
        "insecure": insecure,
    }  # fmt: skip
    told = {key: value for key, value in given.items() if value is not None}
    if config is None:
        for option, key in (("--site", "site"), ("--name", "camera"), ("--source", "source")):
            if key not in told:
                raise InputError("", MISSING, f"{option}, or a camera file")
    names = {} if config is None else {key: f"{config}: {key}" for key in given}
    names |= {key: f"--{key.replace('_', '-')}" for key in told}
    if "camera" in told:
        names["camera"] = "--name"
    with as_typed(names):
        node = load_node(config, told)
        log = open_log("camera", json_logs, site=node.site, camera=node.camera)
        opened = open_camera(node, log)
    opened.run()
    made = opened.node
    print(
        camera_summary(
            node.camera, made.counted, made.schedule.orders, made.schedule.late, made.problem
        )
    )


def up(
    site: Path,
    /,
    *,
    example: Annotated[bool, Parameter(negative="")] = False,
    logs: Path | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    quiet: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Start a whole site on this machine, for trying out: the edge and a process per camera.

    Examples: `e3pose up try --example` makes a simulated site in the folder `try` and runs it;
    `e3pose up site.toml` runs one that is there.

    Every `[[camera]]` of the site file says with `source` what it sees. Shows what `e3pose top`
    shows; Ctrl-C ends all.

    Parameters
    ----------
    site
        The site file, or the folder that has it as site.toml.
    example
        Make the folder first: four cameras that play a simulated scene.
    logs
        Folder for the output of each program; `logs` beside the site file by default.
    for_s
        End by itself after so many seconds.
    quiet
        Show nothing.
    """
    import time

    check_seconds("--for", for_s)
    from rich.console import Console
    from rich.live import Live

    from e3pose.files.private import make_folder
    from e3pose.settings.site_file import load_site
    from e3pose.site.edge_program import check_edge, edge_link
    from e3pose.site.example import make_example
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.site.screen import screen
    from e3pose.site.up import Program, camera_command, edge_command, run_site
    from e3pose.wire.network import open_network

    if example:
        make_example(site)
    table = load_site(site)
    checked = check_edge(table)  # what is wrong is told here, not in a log
    edge_link(table)
    warn(checked.world_warning())
    rig = checked.rig
    folder = logs or table.path.parent / "logs"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--logs: found a file, expected a folder: {folder}")
    programs = [Program("edge", edge_command(table.path), folder / "edge.log")] + [
        Program(i, camera_command(table, i, rig), folder / f"{i}.log") for i in rig.camera_ids
    ]
    transport = open_network(viewer_link(table, None))
    make_folder(folder)
    follower = Follower(table.name)
    follower.listen(transport)
    console = Console(quiet=quiet)
    begun_s = came_s = time.monotonic()
    end_s = None if for_s is None else begun_s + for_s
    shown: list[Any] = [None]
    showing = console.is_terminal and not quiet
    with Live(console=console, auto_refresh=False) if showing else _nothing() as live:

        def stopped() -> bool:
            nonlocal came_s
            if follower.fresh.is_set():
                follower.fresh.clear()
                came_s = time.monotonic()
                shown.append(follower.status)
                del shown[:-1]  # the last of a site at work, not of one that is ending
            if live is not None:
                live.update(screen(follower.status, time.monotonic() - came_s), refresh=True)
            return end_s is not None and time.monotonic() >= end_s

        try:
            run_site(programs, stopped, console.print)
        except KeyboardInterrupt:
            pass
        finally:
            transport.close()
    if shown[-1] is not None and not showing:
        console.print(screen(shown[-1], 0.0))
    console.print(f"ended; logs are in {folder}")


def _look_after_parent(asked: bool) -> None:
    if asked:
        from e3pose.site.run import end_with_parent

        end_with_parent()


@contextmanager
def _nothing() -> Iterator[None]:
    yield None
