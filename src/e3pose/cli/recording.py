"""`e3pose record`: keep what all cameras of a site see."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_seconds, plural

if TYPE_CHECKING:
    from e3pose.edge.record_server import RecordingPlan, RecordServer
    from e3pose.settings.resolved import ResolvedSite

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

    from e3pose.base.atomic import check_free
    from e3pose.base.clock import WallClock
    from e3pose.base.private import make_folder
    from e3pose.edge.record_server import RecordServer
    from e3pose.settings.resolved import resolve
    from e3pose.settings.site_file import load_site
    from e3pose.site.admission import edge_link, join_as_edge
    from e3pose.site.check_sources import require_sources
    from e3pose.site.detector_speed import measure_detections, with_time_for_all
    from e3pose.site.up import Program, camera_command, last_line, run_site

    check_free(dest, None)
    resolved = resolve(load_site(site), placed=False)
    require_sources(resolved)
    times = measure_detections(resolved, again=False)
    if times is not None and (slower := with_time_for_all(resolved, times)) is not resolved:
        rate, pace = f"{slower.fps:.3g} slots per second", f" at pace {slower.pace:g}"
        print(f"With all cameras active: {rate}{pace if slower.pace != 1 else ''}")
        resolved = slower
    folder = logs or resolved.folder / "logs"
    local = [name for name, camera in resolved.cameras.items() if camera.source]
    programs = [Program(i, camera_command(resolved, i), folder / f"{i}.log") for i in local]
    console = Console()
    transport = join_as_edge(*edge_link(resolved))
    make_folder(folder)
    shown_s = time.monotonic()
    with RecordServer(_plan(resolved, dest, for_s), transport, WallClock()) as server:

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
    _report(server, resolved.calibration)


def _plan(site: ResolvedSite, dest: Path, for_s: float | None) -> RecordingPlan:
    from e3pose.edge.record_server import RecordingPlan

    return RecordingPlan(
        dest,
        site.name,
        site.rig,
        site.skeleton,
        site.fps,
        site.pace,
        site.named_detector,
        for_s,
    )


def _progress(server: RecordServer) -> str:
    if server.slots == 0 and (problems := server.problems()):
        missing = "; ".join(f"{name}: {why}" for name, why in problems.items())
        return f"waiting for cameras: {missing}"
    seconds = server.slots / server.plan.fps
    ids = server.plan.rig.camera_ids
    seen = ", ".join(f"{i} {n}" for i, n in zip(ids, server.people.tolist(), strict=True))
    return f"{seconds:.0f} s recorded; poses detected: {seen}"


def _report(server: RecordServer, calibration: Path) -> None:
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
        print(f"Next: e3pose calibrate extrinsics {server.written} {calibration} --update")
