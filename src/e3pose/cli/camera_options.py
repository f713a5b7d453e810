"""Options of `e3pose camera`, each in place of a key of the camera file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from e3pose.cli.options import POWER, Flag, Whole
from e3pose.errors import MISSING, InputError

CONNECTION = Group("Connection", sort_key=1)
DETECTION = Group("Detection", sort_key=2)
VIDEO = Group("Recording", sort_key=4)
NEEDED = {"site": "--site", "camera": "--name", "source": "--source"}  # without a file


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Settings of a camera, which take precedence over its file."""

    site: Annotated[str | None, Parameter(group=CONNECTION)] = None
    """Site name."""
    name: Annotated[str | None, Parameter(group=CONNECTION)] = None
    """Camera id in the site's calibration."""
    endpoint: Annotated[str | None, Parameter(group=CONNECTION)] = None
    """Endpoint of the edge: tls/HOST:PORT, or tcp/HOST:PORT on the same machine."""
    keys: Annotated[str | None, Parameter(group=CONNECTION)] = None
    """Folder from `e3pose keys add`."""
    insecure: Annotated[Flag | None, Parameter(group=CONNECTION)] = None
    """Allow unencrypted tcp beyond this machine."""
    pictures: Annotated[Flag | None, Parameter(group=CONNECTION)] = None
    """Let the site's live page show small pictures of what the camera detects in."""
    source: str | None = None
    """usb:0, rtsp://..., gstreamer:PIPELINE, a video, a folder of images, recorded:RECORDING."""
    fps: float | None = None
    """Frame rate to request from the source."""
    rotation: Whole | None = None
    """0, 90, 180 or 270: degrees clockwise that make people in the images upright, for a camera
    mounted on its side. Only the detector sees turned images."""
    pace: float | None = None
    """Playback speed of a file or recording; must equal the site's `pace`. Default: 1."""
    begin_s: float | None = None
    """Start time of playback in seconds since 1970. Default: playback loops are aligned to 1970,
    so that all cameras show the same moment."""
    wake_s: float | None = None
    """Seconds from aggressive power-saving to the first frame."""
    delay_ms: float | None = None
    """Milliseconds from the moment that a frame shows to its arrival; `e3pose sync` finds them."""
    detector: Annotated[str | None, Parameter(group=DETECTION)] = None
    """2D pose network; see `e3pose models list`."""
    model: Annotated[str | None, Parameter(group=DETECTION)] = None
    """Network file."""
    provider: Annotated[str | None, Parameter(group=DETECTION)] = None
    """Execution provider: auto, tensorrt, cuda, openvino, coreml, cpu."""
    threads: Annotated[Whole | None, Parameter(group=DETECTION)] = None
    """CPU threads of the network. Default: all cores."""
    battery_wh: Annotated[float | None, Parameter(group=POWER)] = None
    """Battery capacity. Default: mains power."""
    meter: Annotated[str | None, Parameter(group=POWER)] = None
    """Power measurement: auto, or model for the profile's figures."""
    profile: Annotated[str | None, Parameter(group=POWER)] = None
    """Power profile for whatever cannot be measured."""
    state: Annotated[str | None, Parameter(group=POWER)] = None
    """File that stores the modelled charge of a battery without a gauge. Default:
    NAME.battery.json beside the camera file. Delete it after charging the battery."""
    videos: Annotated[str | None, Parameter(group=VIDEO)] = None
    """Folder for videos of what the camera sees, one frame per slot. Default: none are recorded."""
    videos_max_size: Annotated[str | None, Parameter(group=VIDEO)] = None
    """Maximum size of its videos, such as 10GB; the oldest are deleted. Default: 10GB."""
    videos_part: Annotated[str | None, Parameter(group=VIDEO)] = None
    """Length of one video, such as 10min, best that of the site's recordings. Default: 10min."""

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
