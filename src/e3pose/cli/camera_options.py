"""Options of `e3pose camera`, each in place of a key of the camera file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from cyclopts import Group

from e3pose.base.errors import MISSING, InputError
from e3pose.cli.options import GROUPS
from e3pose.cli.settings_options import options_from
from e3pose.settings.camera_file import NodeTable

CAMERA_GROUPS = {
    "Connection": Group("Connection", sort_key=1),
    "Detection": Group("Detection", sort_key=2),
    "Recording": Group("Recording", sort_key=4),
}
NEEDED = {"site": "--site", "camera": "--name", "source": "--source"}  # without a file


@options_from(NodeTable, {**GROUPS, **CAMERA_GROUPS}, defaults=False)
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Settings of a camera, which take precedence over its file."""

    def given(self, config: Path | None) -> tuple[dict[str, Any], Mapping[str, str]]:
        """Return the keys that were given, and the option or key that errors name for each.

        Raises:
            InputError: when there is no camera file, and an option that it would hold is missing.
        """
        keys = {item.name: getattr(self, item.name) for item in fields(self)}
        keys["camera"] = keys.pop("name")
        options = {key: value for key, value in keys.items() if value is not None}
        if config is None:
            for key, option in NEEDED.items():
                if key not in options:
                    raise InputError("", MISSING, f"{option}, or a camera file")
        names = {} if config is None else {key: f"{config}: {key}" for key in keys}
        names |= {key: f"--{key.replace('_', '-')}" for key in options}
        return options, names | ({"camera": "--name"} if "camera" in options else {})
