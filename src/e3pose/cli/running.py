"""`e3pose edge`, `camera`, `up`: the live programs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from e3pose.cli.options import Whole, as_typed, warn
from e3pose.errors import MISSING, InputError
from e3pose.quantities import check_seconds, duration_s

if TYPE_CHECKING:
    from e3pose.settings.live import LiveSite
    from e3pose.settings.site_file import SiteTable

# For programs that start others: `site.up`.
Child = Annotated[bool, Parameter(negative="", show=False)]


def edge(
    site: Path,
    /,
    *,
    delay: str | None = None,
    json_logs: Annotated[bool, Parameter(negative="")] = False,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    end_with_parent: Child = False,
) -> None:
    """Run the edge server of a site: receive views, estimate poses, select cameras.

    Example: `e3pose edge site.toml`

    The edge waits for cameras, closes a slot when all views have arrived or its deadline has
    passed, and publishes the poses of each slot. Ctrl-C stops it with a summary; a restart resumes
    from the saved state. Watch it with `e3pose top site.toml`.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
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
    _look_after_parent(end_with_parent)
    check_seconds("--for", for_s)
    from e3pose.settings.site_file import load_site
    from e3pose.site.edge_program import open_edge
    from e3pose.site.logs import open_log
    from e3pose.site.summary import edge_summary

    table = _delayed(load_site(site), delay)
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
    rotation: Whole | None = None,
    fps: float | None = None,
    pace: float | None = None,
    begin_s: float | None = None,
    wake_s: float | None = None,
    delay_ms: float | None = None,
    battery_wh: float | None = None,
    meter: str | None = None,
    profile: str | None = None,
    state: str | None = None,
    insecure: Annotated[bool | None, Parameter(negative="")] = None,
    pictures: Annotated[bool | None, Parameter(negative="")] = None,
    videos: str | None = None,
    videos_max_size: str | None = None,
    videos_part: str | None = None,
    json_logs: Annotated[bool, Parameter(negative="")] = False,
    end_with_parent: Child = False,
) -> None:
    """Run one camera: capture, detect in selected slots, send keypoints.

    Example: `e3pose camera camera.toml`

    Without a file: `e3pose camera --site lab --name cam1 --source usb:0 --endpoint
    tls/edge.local:7447 --keys cam1`

    Images stay on the camera. The program connects and reconnects to the edge by itself and runs
    the detector only in slots in which the camera is selected. Stop it with Ctrl-C.

    Parameters
    ----------
    config
        Camera file; the options below take precedence.
    site
        Site name.
    name
        Camera id in the site's calibration.
    source
        usb:0, rtsp://..., gstreamer:PIPELINE, a video, a folder of images, recorded:RECORDING.
    endpoint
        Endpoint of the edge: tls/HOST:PORT, or tcp/HOST:PORT on the same machine.
    keys
        Folder from `e3pose keys add`.
    detector
        2D pose network; see `e3pose models list`.
    model
        Network file.
    provider
        Execution provider: auto, tensorrt, cuda, openvino, coreml, cpu.
    threads
        CPU threads of the network. Default: all cores.
    rotation
        0, 90, 180 or 270: degrees clockwise that make people in the images upright, for a camera
        mounted on its side. Only the detector sees turned images.
    fps
        Frame rate to request from the source.
    pace
        Playback speed of a file or recording; must equal the site's `pace`. Default: 1.
    begin_s
        Start time of playback in seconds since 1970. Default: playback loops are aligned to 1970,
        so that all cameras show the same moment.
    wake_s
        Seconds from aggressive power-saving to the first frame.
    delay_ms
        Milliseconds from the moment that a frame shows to its arrival; `e3pose sync` finds them.
    battery_wh
        Battery capacity. Default: mains power.
    meter
        Power measurement: auto, or model for the profile's figures.
    profile
        Power profile for whatever cannot be measured.
    state
        File that stores the modelled charge of a battery without a gauge. Default:
        NAME.battery.json beside the camera file. Delete it after charging the battery.
    insecure
        Allow unencrypted tcp beyond this machine.
    pictures
        Let operators of the site see small pictures of what the camera looks at.
    videos
        Folder for videos of what the camera sees, one frame per slot. Default: none are recorded.
    videos_max_size
        Maximum size of its videos, such as 10GB; the oldest are deleted. Default: 10GB.
    videos_part
        Length of one video, such as 10min, best that of the site's recordings. Default: 10min.
    json_logs
        Log as JSON, one object per line.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    _look_after_parent(end_with_parent)
    from e3pose.settings.camera_file import load_node
    from e3pose.site.camera_program import open_camera
    from e3pose.site.logs import open_log
    from e3pose.site.summary import camera_summary

    given = {
        "site": site, "camera": name, "source": source, "endpoint": endpoint, "keys": keys,
        "detector": detector, "model": model, "provider": provider, "threads": threads,
        "rotation": rotation, "fps": fps, "pace": pace, "begin_s": begin_s,
        "wake_s": wake_s, "delay_ms": delay_ms,
        "battery_wh": battery_wh, "meter": meter, "profile": profile, "state": state,
        "insecure": insecure, "pictures": pictures, "videos": videos,
        "videos_max_size": videos_max_size, "videos_part": videos_part,
    }  # fmt: skip
    options = {key: value for key, value in given.items() if value is not None}
    if config is None:
        for option, key in (("--site", "site"), ("--name", "camera"), ("--source", "source")):
            if key not in options:
                raise InputError("", MISSING, f"{option}, or a camera file")
    names = {} if config is None else {key: f"{config}: {key}" for key in given}
    names |= {key: f"--{key.replace('_', '-')}" for key in options}
    if "camera" in options:
        names["camera"] = "--name"
    with as_typed(names):
        node = load_node(config, options)
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
    example: Annotated[bool, Parameter(negative="")] = False,
    view: Annotated[bool, Parameter(negative="")] = False,
    delay: str | None = None,
    logs: Path | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    quiet: Annotated[bool, Parameter(negative="")] = False,
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
    from e3pose.site.up import Program, camera_command, edge_command, run_site, view_command
    from e3pose.wire.network import check_port, open_network

    if example:
        make_example(site)
    table = _delayed(load_site(site), delay)
    checked = check_edge(table)  # an error is shown here, not in a log
    check_port(edge_link(table)[0].endpoint)
    warn(checked.world_warning())
    rig = checked.rig
    _check_looks(table, checked)
    folder = logs or table.path.parent / "logs"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--logs: found a file, expected a folder: {folder}")
    options = () if delay is None else ("--delay", delay)
    programs = [Program("edge", edge_command(table.path, *options), folder / "edge.log")] + [
        Program(i, camera_command(table, i, rig), folder / f"{i}.log") for i in rig.camera_ids
    ]
    console = Console(quiet=quiet)
    if view:
        from e3pose.site.web.program import address_of, page_links

        programs.append(Program("view", view_command(table.path), folder / "view.log"))
        print("\n".join(page_links(table, address_of(table))), flush=True)
    transport = open_network(viewer_link(table, None))
    make_folder(folder)
    follower = Follower(table.name)
    follower.listen(transport)
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
    console.print(f"Stopped. Logs: {folder}", highlight=False)


def _check_looks(site: SiteTable, live: LiveSite) -> None:
    """Refuse settings with which this machine cannot keep up; warn of those that are tight."""
    from rich.console import Console

    from e3pose.site.check_sources import require_sources
    from e3pose.site.detector_speed import check_looks, hopeless, measure_looks

    require_sources(site, live.rig)  # an error is shown here, not in the log of a camera
    with Console(stderr=True).status("measuring the networks"):
        times = measure_looks(site, live.rig, again=False)
    if times is None:
        return
    selected = live.loop.num_selected or len(live.rig)
    for finding in hopeless(site, times, selected):
        raise InputError(f"{site.path}: {finding.what}: {finding.found}: {finding.advice}")
    for finding in check_looks(site, times, selected):
        if finding.level != "ok":
            warn(f"{finding.what}: {finding.found}: {finding.advice}")


def _delayed(site: SiteTable, delay: str | None) -> SiteTable:
    """Return a site that publishes poses a second time after what `--delay` says."""
    if delay is None:
        return site
    with as_typed({"": "--delay", "smooth_delay_ms": "--delay"}):
        return replace(site, smooth_delay_ms=1e3 * duration_s(delay))


def _look_after_parent(asked: bool) -> None:
    if asked:
        from e3pose.site.run import end_with_parent

        end_with_parent()


@contextmanager
def _nothing() -> Iterator[None]:
    yield None
