"""The configuration of one camera: a TOML file, the options of `e3pose camera`, or both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from e3pose.errors import InputError
from e3pose.files.bounded import read_toml
from e3pose.files.table import convert, entry, read_table
from e3pose.geometry.camera_fields import check_camera_id
from e3pose.quantities import duration_s, size_bytes
from e3pose.settings.limits import Rotation, check_camera, check_source, check_within
from e3pose.settings.places import beside, near, placed
from e3pose.settings.site_file import DEFAULT_DETECTOR, DEFAULT_ENDPOINT, MAX_BYTES
from e3pose.settings.sources import located
from e3pose.wire.access import split_endpoint
from e3pose.wire.topics import check_site

CAMERA_FORMAT = "e3pose-camera"


def read_charge_file(found: object) -> Path | Literal[""]:
    """Return the file of a charge, empty for none; raise `InputError` for another sort."""
    name = convert(str, found)
    if name and not name.endswith(".json"):  # it is replaced again and again
        raise InputError("", repr(name[:80]), "a name that ends in .json, or ''")
    return Path(name) if name else ""


@dataclass(frozen=True, slots=True)
class NodeTable:
    """A camera file; the options of `e3pose camera` take precedence.

    Attributes:
        format: `e3pose-camera`.
        version: 1.
        site: name of the site.
        camera: its id there.
        source: see `camera.live_source`.
        endpoint: of the edge.
        keys: folder that `e3pose keys add` made, for tls.
        insecure: whether plain tcp beyond this machine is allowed.
        detector: name of a detector.
        model: file of the network.
        provider: where it runs.
        threads: of the processor for the network; all cores by default.
        rotation: degrees clockwise that make people in its images upright, for the detector alone.
        fps: frames per second to ask of the source; None for its own.
        pace: how fast a file or recording is played.
        begin_s: seconds since 1970 at which a round of it begins, and before which nothing is
            shown; by default rounds are counted from 1970.
        wake_s: seconds from aggressive power-saving to the first frame.
        delay_ms: how long after the moment it shows a frame arrives, which is taken off its time.
        battery_wh: capacity; without it the camera is on mains.
        meter: how its power is measured.
        profile: power profile, for what is not measured.
        state: file that remembers the charge of a battery without a gauge, by default beside the
            camera file; empty for none.
        pictures: whether operators may see small pictures of what it sees.
        videos: folder for videos of what it sees; without it none are recorded.
        videos_max_bytes: the most to keep, such as `10GB`; the oldest videos go first.
        videos_part_s: length of one video, such as `10min`, best that of the site's recordings.
        path: of the file, None without one; relative ones in it and in options start from its
            folder, and were found from there.

    Raises:
        InputError: naming the key, what was found and what was expected.
    """

    format: Literal["e3pose-camera"] = entry()
    version: Literal[1] = entry()
    site: str = entry(write='"lab"')
    camera: str = entry(write='"cam1"')
    source: str = entry(write='"usb:0"')
    endpoint: str = DEFAULT_ENDPOINT
    keys: Path | None = None
    insecure: bool = False
    detector: str = DEFAULT_DETECTOR
    model: Path | None = None
    provider: str = "auto"
    threads: int | None = None
    rotation: Rotation = 0
    fps: float | None = None
    pace: float = 1.0
    begin_s: float = 0.0
    wake_s: float = 0.5
    delay_ms: float = 0.0
    battery_wh: float | None = None
    meter: Literal["auto", "model"] = "auto"
    profile: str = "xavier-nx"
    state: Path | Literal[""] | None = entry(None, read=read_charge_file)
    pictures: bool = False
    videos: Path | None = None
    videos_max_bytes: int | None = entry(None, key="videos_max_size", read=size_bytes)
    videos_part_s: float | None = entry(None, key="videos_part", read=duration_s)
    path: Path | None = field(default=None, metadata={"key": ""})

    def __post_init__(self) -> None:
        check_site(self.site)
        try:
            check_camera_id(self.camera)
        except InputError as error:
            raise error.at(thing="camera") from None
        split_endpoint(self.endpoint)
        if self.fps is not None:
            check_within("fps", self.fps, 0.1, 1000)
        check_within("pace", self.pace, 1e-3, 1)
        check_within("begin_s", self.begin_s, 0, 1e10)
        check_camera(self.wake_s, self.delay_ms, self.battery_wh, self.threads)
        check_source(self.source)


def is_camera_file(path: Path) -> bool:
    """Return whether a file declares itself a camera file; errors in it are raised later."""
    try:
        return path.is_file() and read_toml(path, MAX_BYTES).get("format") == CAMERA_FORMAT
    except InputError:
        return False


def load_node(path: Path | None, options: Mapping[str, Any] | None = None) -> NodeTable:
    """Return the configuration of a camera.

    Args:
        path: of the camera file; None for options alone.
        options: keys of the file that take precedence over it.

    Raises:
        InputError: naming the file, the key, what was found and what was expected; an option
            without the file.
    """
    asked = options or {}
    table: dict[str, Any] = {"format": CAMERA_FORMAT, "version": 1}
    if path is not None:
        if not path.exists():
            raise InputError(
                f"{path}: file not found, expected a camera file; docs/how-to/live-site.md has one"
            )
        table = read_toml(path, MAX_BYTES)
    folder = Path() if path is None else path.parent
    try:
        node = placed(read_table(NodeTable, {**table, **asked}), folder)
        return replace(
            node,
            path=path,
            source=located(node.source, partial(near, folder)),
            detector=beside(folder, node.detector),
            state=_usual_state(path) if node.state is None else node.state,
        )
    except InputError as error:
        raise error if error.thing in asked or path is None else error.at(path) from None


def _usual_state(path: Path | None) -> Path | None:
    return None if path is None else path.with_name(f"{path.stem}.battery.json")
