"""`e3pose camera`: one camera of a site."""

from __future__ import annotations

from pathlib import Path

from e3pose.cli.camera_options import CameraOptions
from e3pose.cli.options import Flag, as_typed
from e3pose.cli.running import Child, begin
from e3pose.settings.camera_file import load_node
from e3pose.site.summary import camera_summary

CAMERA = CameraOptions()


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
    begin(end_with_parent)
    from e3pose.site.camera_program import open_camera
    from e3pose.site.logs import open_log

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
