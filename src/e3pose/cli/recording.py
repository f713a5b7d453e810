"""`e3pose record`: keep what all cameras of a site see."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from e3pose.base.quantities import check_seconds, plural, shell
from e3pose.cli.running import begin
from e3pose.settings.site_file import load_site

if TYPE_CHECKING:
    from e3pose.edge.record_server import RecordServer


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
    others connect by themselves. Stop the edge first; a running site records with
    `record = "keypoints"` in its file. Ctrl-C ends the recording.

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
    begin()
    check_seconds("--for", for_s)
    from e3pose.site.record_program import record_site

    console = Console()

    def say(line: str) -> None:
        console.print(line, highlight=False, soft_wrap=True)

    table = load_site(site)
    server = record_site(
        table, dest, for_s=for_s, logs=logs, report=say, look=lambda made: say(_progress(made))
    )
    _report(server, table.calibration)


def _progress(server: RecordServer) -> str:
    from e3pose.site.record_program import waiting_words

    if missing := waiting_words(server):
        return f"waiting for cameras: {missing}"
    seconds = server.slots / server.plan.fps
    ids = server.plan.rig.camera_ids
    seen = ", ".join(f"{i} {n}" for i, n in zip(ids, server.people.tolist(), strict=True))
    return f"{seconds:.0f} s recorded; poses detected: {seen}"


def _report(server: RecordServer, calibration: Path) -> None:
    plan = server.plan
    slots = plural(server.slots, "slot")
    print(f"Wrote {server.written}: {slots} at {plan.fps:g} per second")
    for index, camera_id in enumerate(plan.rig.camera_ids):
        views, people = int(server.views[index]), int(server.people[index])
        print(f"  {camera_id}: {plural(views, 'view')}, {plural(people, 'pose')}")
    if (server.views < server.slots / 2).any():
        print("  some cameras missed half of the slots: is fps too high? See e3pose check")
    if not plan.rig.placed:
        print(
            f"Next: e3pose calibrate extrinsics {shell(server.written)} {shell(calibration)} "
            "--height 171cm --update, with the height of the person who walked"
        )
