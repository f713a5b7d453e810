"""`e3pose record`: keep what all cameras of a site see."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.errors import InputError
from e3pose.quantities import check_seconds, plural

if TYPE_CHECKING:
    from e3pose.edge.record_server import RecordingPlan, RecordServer
    from e3pose.settings.site_file import SiteTable

LOOK_S = 1.0
MOST_RESTARTS = 3  # of a camera, before the command reports why it ends


def record(
    site: Path,
    dest: Path,
    /,
    *,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
    logs: Path | None = None,
) -> None:
    """Record what all cameras of a site see, with or without a calibration.

    Example: `e3pose record room walk --for 60`

    All cameras are active in every slot; their keypoints become a recording for `calibrate`,
    `sync`, `replay` and `evaluate`. Cameras with a `source` in the site file run on this machine,
    others connect as they do to the edge, which must not run meanwhile: a running site keeps what
    it sees with `record = "keypoints"` in its file. Ctrl-C ends the recording.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    dest
        The recording folder to create.
    for_s
        Stop after this many seconds of the scene, which take longer where files are played at a
        `pace` below 1. Default: at Ctrl-C.
    logs
        Folder for the logs of the cameras. Default: `logs` beside the site file.
    """
    check_seconds("--for", for_s)
    from rich.console import Console

    from e3pose.edge.record_server import RecordServer
    from e3pose.files.atomic import check_free
    from e3pose.files.private import make_folder
    from e3pose.runtime.clock import WallClock
    from e3pose.settings.live import known_rig
    from e3pose.settings.site_file import load_site
    from e3pose.site.admission import edge_link, join_as_edge
    from e3pose.site.check_sources import require_sources
    from e3pose.site.detector_speed import measure_detections, with_time_for_all
    from e3pose.site.up import Program, camera_command, last_line, run_site

    check_free(dest, None)
    table = load_site(site)
    rig = known_rig(table)
    require_sources(table, rig)
    times = measure_detections(table, rig, again=False)
    if times is not None and (slower := with_time_for_all(table, times)) != table:
        rate, pace = f"{slower.fps:.3g} slots per second", f" at pace {slower.pace:g}"
        print(f"With all cameras active: {rate}{pace if slower.pace != 1 else ''}")
        table = slower
    folder = logs or table.path.parent / "logs"
    local = [name for name, camera in table.cameras_of(rig).items() if camera.source]
    programs = [Program(i, camera_command(table, i, rig), folder / f"{i}.log") for i in local]
    console = Console()
    transport = join_as_edge(*edge_link(table))
    make_folder(folder)
    shown_s = time.monotonic()
    with RecordServer(_plan(table, dest, for_s), transport, WallClock()) as server:

        def stopped() -> bool:
            nonlocal shown_s
            if time.monotonic() - shown_s > LOOK_S:
                shown_s = time.monotonic()
                console.print(_progress(server), highlight=False, soft_wrap=True)
            for program in programs:
                if program.restarts >= MOST_RESTARTS:
                    raise InputError(f"{program.name}: {last_line(program.log)}")
            return not server.running()

        with suppress(KeyboardInterrupt):
            run_site(programs, stopped, console.print)
    if server.threads.failure is not None:
        raise server.threads.failure
    _report(server, table)


def _plan(table: SiteTable, dest: Path, for_s: float | None) -> RecordingPlan:
    from e3pose.edge.record_server import RecordingPlan
    from e3pose.settings.live import known_rig, noise_of
    from e3pose.settings.skeletons import camera_skeletons, site_skeleton

    rig = known_rig(table)
    cameras = table.cameras_of(rig)
    skeleton = site_skeleton(table.skeleton, camera_skeletons(table, cameras).values())
    detector = noise_of(table, cameras)
    return RecordingPlan(dest, table.name, rig, skeleton, table.fps, table.pace, detector, for_s)


def _progress(server: RecordServer) -> str:
    if server.slots == 0 and (problems := server.problems()):
        missing = "; ".join(f"{name}: {why}" for name, why in problems.items())
        return f"waiting for cameras: {missing}"
    seconds = server.slots / server.plan.fps
    ids = server.plan.rig.camera_ids
    seen = ", ".join(f"{i} {n}" for i, n in zip(ids, server.people.tolist(), strict=True))
    return f"{seconds:.0f} s recorded; poses detected: {seen}"


def _report(server: RecordServer, table: SiteTable) -> None:
    if server.written is None:
        reasons = "; ".join(f"{name}: {why}" for name, why in server.problems().items())
        raise InputError(f"nothing was recorded{': ' if reasons else ''}{reasons}")
    plan = server.plan
    slots = plural(server.slots, "slot")
    print(f"Wrote {server.written}: {slots} at {plan.fps:g} per second")
    for index, camera_id in enumerate(plan.rig.camera_ids):
        views, people = int(server.views[index]), int(server.people[index])
        print(f"  {camera_id}: {plural(views, 'view')}, {plural(people, 'pose')}")
    if (server.views < server.slots / 2).any():
        print("  some cameras missed half of the slots: is fps too high? See e3pose check")
    if not plan.rig.placed:
        calibration = table.near(table.calibration)
        print(f"Next: e3pose calibrate extrinsics {server.written} {calibration} --update")
