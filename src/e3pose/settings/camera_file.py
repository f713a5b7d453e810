"""The configuration of one camera: a TOML file, the options of `e3pose camera`, or both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.quantities import duration_s, size_bytes
from e3pose.base.table import convert, entry, read_table
from e3pose.detectors.chooser import AUTO
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.limits import (
    DETECTION,
    CameraMachine,
    Pace,
    Rotation,
    Sleep,
    check_sleep,
    check_source,
)
from e3pose.settings.site_file import DEFAULT_ENDPOINT, MAX_BYTES
from e3pose.settings.sources import beside, located, near, placed
from e3pose.wire.endpoint import Endpoint, read_endpoint
from e3pose.wire.topics import check_site

CAMERA_FORMAT = "e3pose-camera"
CONNECTION, RECORDING = "Connection", "Recording"  # groups of options


def read_charge_file(found: object) -> Path | Literal[""]:
    """Return the file of a charge, empty for none; raise `InputError` for another sort."""
    name = convert(str, found)
    if name and not name.endswith(".json"):  # it is replaced again and again
        raise InputError("", repr(name[:80]), "a name that ends in .json, or ''")
    return Path(name) if name else ""


@dataclass(frozen=True, slots=True)
class NodeTable(CameraMachine):
    """A camera file; the options of `e3pose camera` take precedence.

    See `LoopSettings` for what the fields say, and `CameraMachine` for more of them.

    Attributes:
        format: `e3pose-camera`.
        version: 1.
        suspend_command: words of a command that suspends the machine in place of rtcwake, with
            `{seconds}` for the time until its alarm; it returns once the machine is awake again.
        state: empty for no file.
        path: of the file, None without one; relative ones in it and in options start from its
            folder, and were found from there.

    Raises:
        InputError: naming the key, what was found and what was expected.
    """

    format: Literal["e3pose-camera"] = entry()
    version: Literal[1] = entry()
    site: str = entry(write='"lab"', group=CONNECTION, help="Site name.")
    camera: str = entry(
        write='"cam1"',
        option="name",
        group=CONNECTION,
        help="Camera id in the site's calibration.",
    )
    source: str = entry(
        write='"usb:0"',
        help="usb:0, rtsp://..., gstreamer:PIPELINE, a video, a folder of images, "
        "recorded:RECORDING.",
    )
    endpoint: Endpoint = entry(
        DEFAULT_ENDPOINT,
        read=read_endpoint,
        shown=str(DEFAULT_ENDPOINT),
        group=CONNECTION,
        help="Endpoint of the edge: tls/HOST:PORT, or tcp/HOST:PORT on the same machine.",
    )
    keys: Path | None = entry(None, group=CONNECTION, help="Folder from `e3pose keys add`.")
    insecure: bool = entry(
        False, group=CONNECTION, help="Allow unencrypted tcp beyond this machine."
    )
    pictures: bool = entry(
        False,
        group=CONNECTION,
        help="Let the site's live page show small pictures of what the camera detects in.",
    )
    fps: Annotated[float, Meta(ge=0.1, le=1000)] | None = entry(
        None, help="Frame rate to request from the source."
    )
    rotation: Rotation = entry(
        0,
        help="""0, 90, 180 or 270: degrees clockwise that make people in the images upright, for a
        camera mounted on its side. Only the detector sees turned images.""",
    )
    pace: Pace = entry(
        1.0,
        help="""Playback speed of a file or recording; must equal the site's `pace`. Default: 1.""",
    )
    begin_s: Annotated[float, Meta(ge=0, le=1e10)] = entry(
        0.0,
        help="""Start time of playback in seconds since 1970. Default: playback loops are aligned
        to 1970, so that all cameras show the same moment.""",
    )
    detector: str = entry(
        AUTO,
        group=DETECTION,
        help="2D pose network: a name from `e3pose models list`, or auto for the best one here.",
    )
    meter: Literal["auto", "model"] = entry(
        "auto",
        group="Energy",
        help="Power measurement: auto, or model for the profile's figures.",
    )
    sleep: Sleep = entry(
        "process",
        group="Energy",
        help="""How orders may put the camera to sleep: off, process (the source is closed, the
        program waits), or suspend (the machine, by rtcwake).""",
    )
    suspend_command: tuple[str, ...] = ()
    profile: str = entry(
        "xavier-nx", group="Energy", help="Power profile for whatever cannot be measured."
    )
    state: Path | Literal[""] | None = entry(
        None,
        read=read_charge_file,
        group="Energy",
        help="""File that stores the modelled charge of a battery without a gauge. Default:
        NAME.battery.json beside the camera file. Delete it after charging the battery.""",
    )
    videos: Path | None = entry(
        None,
        group=RECORDING,
        help="""Folder for videos of what the camera sees, one frame per slot. Default: none are
        recorded.""",
    )
    videos_max_bytes: int | None = entry(
        None,
        key="videos_max_size",
        read=size_bytes,
        group=RECORDING,
        help="""Maximum size of its videos, such as 10GB; the oldest are deleted. Default: 10GB.""",
    )
    videos_part_s: float | None = entry(
        None,
        key="videos_part",
        read=duration_s,
        group=RECORDING,
        help="""Length of one video, such as 10min, best that of the site's recordings. Default:
        10min.""",
    )
    path: Path | None = field(default=None, metadata={"key": ""})

    def __post_init__(self) -> None:
        check_site(self.site)
        try:
            check_camera_id(self.camera)
        except InputError as error:
            raise error.at(thing="camera") from None
        CameraMachine.__post_init__(self)
        check_source(self.source)
        check_sleep(self.sleep, self.suspend_command)


def is_camera_file(path: Path) -> bool:
    """Return whether a file declares itself a camera file; errors in it are raised later."""
    try:
        return path.is_file() and read_toml(path, MAX_BYTES).get("format") == CAMERA_FORMAT
    except InputError:
        return False


def load_node(
    path: Path | None, options: Mapping[str, Any] | None = None, new: bool = False
) -> NodeTable:
    """Return the configuration of a camera.

    Args:
        path: of the camera file; None for options alone.
        options: keys of the file that take precedence over it.
        new: whether the file is yet to be made, of the options.

    Raises:
        InputError: naming the file, the key, what was found and what was expected; an option
            without the file.
    """
    asked = options or {}
    table: dict[str, Any] = {"format": CAMERA_FORMAT, "version": 1}
    if path is not None and not new:
        if not path.exists():
            raise InputError(
                f"{path}: file not found, expected a camera file; docs/how-to/live-site.md has one"
            )
        table = read_toml(path, MAX_BYTES)
    folder = Path() if path is None else path.parent
    try:
        written = read_table(NodeTable, {**table, **asked})
        node = placed(written, folder)
        state = node.state
        if state is None and path is not None:
            state = path.with_name(f"{path.stem}.battery.json")
        source = located(node.source, partial(near, folder))
        detector = beside(folder, node.detector)
        return replace(node, path=path, source=source, detector=detector, state=state)
    except InputError as error:
        raise error if error.thing in asked or path is None else error.at(path) from None
