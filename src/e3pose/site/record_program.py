"""Record the views of all cameras of a site; local cameras run as separate programs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from e3pose.base.atomic import check_free
from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.edge.record_server import RecordingPlan, RecordServer, Watch, ignore_views
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import SiteTable
from e3pose.site.admission import edge_link
from e3pose.site.check.finding import report as report_findings
from e3pose.site.check.sources import source_problems
from e3pose.site.detector_speed import measure_detections, with_time_for_all
from e3pose.site.up import camera_program, run_site
from e3pose.wire.network import open_network

LOOK_S = 1.0


def record_site(
    site: SiteTable,
    dest: Path,
    *,
    for_s: float | None = None,
    logs: Path | None = None,
    report: Callable[[str], None],
    look: Callable[[RecordServer], object],
    watch: Watch = ignore_views,
) -> RecordServer:
    """Record all cameras of a site until Ctrl-C, `for_s`, or an exception of `look`.

    Args:
        site: what its file says.
        dest: the recording folder to create.
        for_s: seconds of the scene; None for no end.
        logs: folder of the logs of cameras; by default beside the site file.
        report: called with lines for operators.
        look: called about every second with the recorder; `KeyboardInterrupt` ends it in order.
        watch: called with each slot, on the recorder's thread.

    Returns:
        The recorder, which is closed; its `written` is the recording.

    Raises:
        InputError: for sources that are not there, and when nothing was recorded.
        Fault: for what ended the recording early.
    """
    check_free(dest, None)
    resolved = resolve(site, placed=False)
    report_findings(source_problems(resolved), report, str(resolved.file.path))
    times = measure_detections(resolved, again=False)
    if times is not None and (slower := with_time_for_all(resolved, times)) is not resolved:
        rate, pace = f"{slower.file.fps:.3g} slots per second", f" at pace {slower.file.pace:g}"
        report(f"With all cameras active: {rate}{pace if slower.file.pace != 1 else ''}")
        resolved = slower
    folder = logs or resolved.file.folder / "logs"
    local = [name for name, camera in resolved.cameras.items() if camera.source]
    programs = [camera_program(resolved, camera_id, folder) for camera_id in local]
    transport = open_network(*edge_link(resolved.file))
    with suppress(OSError):  # cameras then run without logs
        make_folder(folder)
    looked_s = time.monotonic()
    file = resolved.file
    plan = RecordingPlan(
        dest, file.name, resolved.rig, resolved.skeleton, file.fps, file.pace,
        resolved.named_detector, for_s, resolved.known_joints,
    )  # fmt: skip
    with RecordServer(plan, transport, WallClock(), watch) as server:

        def stopped() -> bool:
            nonlocal looked_s
            if time.monotonic() - looked_s > LOOK_S:
                looked_s = time.monotonic()
                look(server)
            return not server.running()

        with suppress(KeyboardInterrupt):
            run_site(programs, stopped, report)
    server.threads.check()
    if server.written is None:
        reasons = "; ".join(f"{name}: {why}" for name, why in server.problems().items())
        raise InputError(f"nothing was recorded{': ' if reasons else ''}{reasons}")
    return server


def waiting_words(server: RecordServer) -> str:
    """Return for which cameras a recorder waits, and why; empty once it records."""
    if server.slots or not (problems := server.problems()):
        return ""
    return "; ".join(f"{name}: {why}" for name, why in problems.items())
