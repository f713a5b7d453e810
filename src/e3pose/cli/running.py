"""`e3pose edge`, `camera`, `up`: a site at work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from e3pose.cli.options import Whole, as_typed
from e3pose.cli.site_settings import check_settings, open_ledger, site_rig
from e3pose.errors import InputError
from e3pose.settings.quantities import check_seconds

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
    from contextlib import ExitStack

    _look_after_parent(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.clock import WallClock
    from e3pose.settings.loop import noise_warning
    from e3pose.settings.site_file import open_site
    from e3pose.site.edge_program import Admission, edge_link, make_edge, place_of
    from e3pose.site.logs import open_log
    from e3pose.site.quiet import be_quiet
    from e3pose.site.run import run_until_stopped
    from e3pose.site.summary import edge_summary
    from e3pose.wire.network import open_network

    site, table = open_site(site)
    rig = site_rig(site, table)
    settings = check_settings(site, table, rig)
    place = place_of(site, table, rig)
    link, roll = edge_link(site, table)
    log = open_log("edge", json_logs, site=table.name)
    if warning := noise_warning(place, settings):
        log.warning(warning)
    clock = WallClock()
    with ExitStack() as stack:
        transport = open_network(link, *_people(roll))
        stack.callback(transport.close)

        def tell(event: Any) -> None:
            log.info(event.message, kind=event.kind, camera=event.camera_id)

        server = make_edge(site, table, place, settings, transport, clock, tell, stack)
        server.ledger = open_ledger(site, table, rig, settings, server)
        if table.metrics_port is not None:
            from e3pose.site.metrics import serve_metrics

            stack.callback(serve_metrics(server, table.metrics_port).shutdown)
        stack.callback(server.stop)
        log.info("getting ready; the very first time this compiles for a minute or two")
        server.start()
        be_quiet()
        log.info("waiting for cameras", endpoint=link.endpoint, cameras=len(rig))
        end_ns = None if for_s is None else clock.now_ns() + round(for_s * 1e9)
        admission = Admission(
            site, table, server, lambda link, roll: open_network(link, *_people(roll)), log.info
        )

        def running() -> bool:
            admission.look()
            return server.running() and (end_ns is None or clock.now_ns() < end_ns)

        run_until_stopped(running)
        server.stop()
        if server.failure is not None:
            raise server.failure
        counts = server.counts
        print("\n".join(edge_summary(server.status(), counts.slots, counts.views)))


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
    from e3pose.clock import WallClock
    from e3pose.energy.meters.sampler import open_sampler
    from e3pose.energy.profiles import load_profile
    from e3pose.settings.site_file import load_node
    from e3pose.site.camera_program import EdgeWatch, camera_link, make_camera, remembered_charge
    from e3pose.site.logs import open_log
    from e3pose.site.run import run_until_stopped
    from e3pose.site.summary import camera_summary
    from e3pose.wire.network import open_network

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
                raise InputError(f"{option}: not found, expected it or a camera file")
    names = {} if config is None else {key: f"{config}: {key}" for key in given}
    names |= {key: f"--{key.replace('_', '-')}" for key in told}
    if "camera" in told:
        names["camera"] = "--name"
    folder = Path() if config is None else config.parent
    try:
        node = load_node(config, told)
        link = camera_link(node, folder)
        log = open_log("camera", json_logs, site=node.site, camera=node.camera)
        clock = WallClock()
        charge = remembered_charge(node, config, log.warning)
        power = open_sampler(load_profile(node.profile), node.meter, node.battery_wh, charge)
        transport = open_network(link)
        made = make_camera(node, folder, transport, clock, log.warning, power)
    except InputError as error:
        raise as_typed(error, names) from None
    power.mode = lambda: made.mode
    with power, made:
        log.info("ready", source=node.source, endpoint=node.endpoint)
        watch = EdgeWatch(log.info, node.endpoint)

        def running() -> bool:
            watch.look(made.edge_there, clock.now_ns() / 1e9)
            return made.running()

        run_until_stopped(running)
        counted = made.counted
    if made.failure is not None:
        raise made.failure
    schedule = made.schedule
    print(camera_summary(node.camera, counted, schedule.orders, schedule.late, made.problem))


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
    from e3pose.settings.site_file import open_site
    from e3pose.site.edge_program import edge_link
    from e3pose.site.example import make_example
    from e3pose.site.follow import Follower, viewer_link
    from e3pose.site.screen import screen
    from e3pose.site.up import Program, camera_command, edge_command, run_site
    from e3pose.wire.network import open_network

    if example:
        make_example(site)
    site, table = open_site(site)
    rig = site_rig(site, table)
    check_settings(site, table, rig)  # what is wrong is told here, not in a log
    edge_link(site, table)
    folder = logs or site.parent / "logs"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--logs: found a file, expected a folder: {folder}")
    programs = [Program("edge", edge_command(site), folder / "edge.log")] + [
        Program(i, camera_command(site, table, i, rig), folder / f"{i}.log") for i in rig.camera_ids
    ]
    transport = open_network(viewer_link(site, table, None))
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


def _people(roll: Any) -> tuple[Any, Any, Any]:
    return (None,) * 3 if roll is None else (roll.cameras, roll.viewers, roll.routers)
