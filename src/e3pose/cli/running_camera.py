"""`e3pose camera`: one camera of a site."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from cyclopts import Group

from e3pose.base.errors import MISSING, InputError
from e3pose.base.masking import has_secret
from e3pose.base.quantities import shell
from e3pose.cli.options import Flag, as_typed, ask, warn
from e3pose.cli.running import Child, begin
from e3pose.cli.settings_options import options_from
from e3pose.settings.camera_file import NodeTable, load_node
from e3pose.site.summary import camera_summary

CAMERA_GROUPS = {
    "Connection": Group("Connection", sort_key=1),
    "Detection": Group("Detection", sort_key=2),
    "Energy": Group("Energy", sort_key=3),
    "Recording": Group("Recording", sort_key=4),
}
NEEDED = {"site": "--site", "camera": "--name", "source": "--source"}  # without a file


@options_from(NodeTable, CAMERA_GROUPS, defaults=False)
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Settings of a camera, which take precedence over its file."""

    def given(
        self, config: Path | None, needed: Collection[str] = tuple(NEEDED)
    ) -> tuple[dict[str, Any], Mapping[str, str]]:
        """Return the keys that were given, and the option or key that errors name for each.

        Args:
            config: the camera file.
            needed: keys that must be given without one.

        Raises:
            InputError: when there is no camera file, and an option that it would hold is missing.
        """
        keys = {item.name: getattr(self, item.name) for item in fields(self)}
        keys["camera"] = keys.pop("name")
        options = {key: value for key, value in keys.items() if value is not None}
        if config is None:
            for key in needed:
                if key not in options:
                    raise InputError("", MISSING, f"{NEEDED[key]}, or a camera file")
        names = {} if config is None else {key: f"{config}: {key}" for key in keys}
        names |= {key: f"--{key.replace('_', '-')}" for key in options}
        return options, names | ({"camera": "--name"} if "camera" in options else {})


CAMERA = CameraOptions()


def camera(
    config: Path | None = None,
    /,
    *,
    options: CameraOptions = CAMERA,
    join: Flag = False,
    json_logs: Flag = False,
    end_with_parent: Child = False,
) -> None:
    """Run one camera: capture, detect in selected slots, send keypoints.

    Example: `e3pose camera camera.toml`

    Without a file: `e3pose camera --site lab --name cam1 --source usb:0 --endpoint
    tls/edge.local:7447 --keys cam1`

    A new camera: `e3pose camera --join --name cam1 --source usb:0` asks for the code that the page
    of the site shows (or `e3pose keys join` there), makes its keys in `cam1` and `cam1.toml`.

    Images stay on the camera, except for small ones with `--pictures`. The program connects and
    reconnects to the edge by itself and runs the detector only in slots in which the camera is
    selected. Stop it with Ctrl-C.

    Parameters
    ----------
    config
        Camera file; the options below take precedence.
    join
        Join the site by a code, and end: the keys and, if there is none, the camera file are made.
        The edge is found in the network, or at the host of --endpoint.
    json_logs
        Log as JSON, one object per line.
    end_with_parent
        Stop when standard input closes, a pipe from the parent process.
    """
    begin(end_with_parent)
    from e3pose.site.camera_program import join_site, open_camera
    from e3pose.site.logs import open_log

    if join:
        path = config or Path(f"{options.name}.toml")  # type: ignore[attr-defined]
        given, names = options.given(path if path.exists() else None, ("camera", "source"))
        with as_typed(names):
            ended = InputError("code", MISSING, "the six digits, typed or piped in")
            joined = join_site(path, given, partial(ask, ended=ended))
            print(joined, f"next: e3pose camera {shell(path)}", sep="; ")
        return
    given, names = options.given(config)
    with as_typed(names):
        node = load_node(config, given)
        if has_secret(given.get("source", "")):
            warn(
                "every user of this machine can read the password in --source while the camera "
                "runs: --source secret:FILE reads it from a private file, env:NAME from a variable"
            )
        log = open_log("camera", json_logs, site=node.site, camera=node.camera)
        opened = open_camera(node, log)
    opened.run()
    made = opened.node
    print(
        camera_summary(
            node.camera, made.counts, made.schedule.orders, made.schedule.late, made.problem
        )
    )
