"""The site file: TOML, validated, with paths relative to the file.

`docs/reference/site-file.md` describes both. Keys of `[loop]` and `[energy]` are the options of
`e3pose replay`.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from msgspec import Meta

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.plugins import beside as own_beside
from e3pose.base.quantities import age_s, check_within, duration_s, shell, size_bytes
from e3pose.base.table import check_bounds, convert, entry, read_table
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.energy import EnergySettings, IdleMode
from e3pose.settings.events_table import EventsTable
from e3pose.settings.limits import (
    CameraMachine,
    Pace,
    Rotation,
    check_smooth_delay,
    check_source,
)
from e3pose.settings.loop import LoopSettings
from e3pose.settings.sources import beside, located, near, placed
from e3pose.wire.endpoint import Endpoint, read_endpoint, read_endpoints, read_host_port
from e3pose.wire.topics import check_site

MAX_BYTES = 2**20
MAX_CORNERS = 100
SITE_FILE = "site.toml"
T = TypeVar("T")
DEFAULT_ENDPOINT = Endpoint("tcp", "127.0.0.1", 7447)
DEFAULT_LISTEN = Endpoint("tcp", "127.0.0.1", 8470)


def read_place(found: object) -> Path | str:
    """Return the file of a store or its URL; raise `InputError` for anything else."""
    return found if isinstance(found, str) and "://" in found else convert(Path, found)


def read_state(found: object) -> Path | None:
    """Return the file of a state, None for an empty name; raise `InputError` for another sort."""
    name = convert(str, found)
    if name and not name.endswith(".npz"):  # it is replaced again and again
        raise InputError("", repr(name[:80]), "a name that ends in .npz, or ''")
    return Path(name) if name else None


@dataclass(frozen=True, slots=True)
class LinkTable:
    """`[link]`: where the edge listens.

    Attributes:
        endpoint: `tls/HOST:PORT`, or `tcp/HOST:PORT` on loopback.
        keys: folder of `e3pose keys`, for tls.
        upstream: routers to join, where sites share them.
        insecure: whether plain tcp beyond this machine is allowed.
    """

    endpoint: Endpoint = entry(DEFAULT_ENDPOINT, read=read_endpoint)
    keys: Path | None = None
    upstream: tuple[Endpoint, ...] = entry((), read=read_endpoints)
    insecure: bool = False


@dataclass(frozen=True, slots=True)
class StoreTable:
    """`[store]`: where every slot is kept.

    Attributes:
        place: a file (SQLite) or the URL of a database, `postgresql://USER@HOST/NAME`.
        keep_s: the oldest to keep, such as `30d`.
        max_bytes: the most to keep, such as `20GB`; of a file only.
        spool_bytes: room for what the database cannot take, such as `200MB`.
        outbox_s: how many minutes of summaries to keep, such as `60d`.
        publish: when poses are published: `at-once`, or once they are `stored`.
    """

    place: Path | str = entry(key="path", read=read_place, write='"poses.db"')
    keep_s: float | None = entry(None, key="keep", read=age_s)
    max_bytes: int | None = entry(None, key="max_size", read=size_bytes)
    spool_bytes: int = entry(32_000_000, key="spool", read=size_bytes)
    outbox_s: float = entry(60 * 86400.0, key="outbox", read=age_s, write='"60d"')
    publish: Literal["at-once", "stored"] = "at-once"

    def __post_init__(self) -> None:
        check_within("spool", self.spool_bytes, 1e6, 1e9)
        check_within("outbox", self.outbox_s, 3600, 1e8)


@dataclass(frozen=True, slots=True)
class ViewTable:
    """`[view]`: where `e3pose view` serves its page, API and streams.

    Attributes:
        listen: `HOST:PORT`; beyond loopback it needs keys or `insecure`, and every reader a token.
        hosts: names by which browsers reach it, beside `localhost` and that of the machine.
        proxies: addresses of reverse proxies before it, such as 127.0.0.1: the clients that they
            name are believed, and every reader needs a token.
        tokens: file of the tokens, made where it is missing.
        hubs: whose users may open the page, each by a token of their own.
        insecure: whether plain http beyond this machine is allowed.
        pictures: whether the page shows small pictures of what cameras see; by default where it
            listens on loopback. Each camera must allow it too.
        pictures_per_s: the most that it asks each camera for.
    """

    listen: Endpoint = entry(DEFAULT_LISTEN, read=read_host_port)
    hosts: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    tokens: Path = Path("view-tokens.toml")
    hubs: tuple[str, ...] = ()
    insecure: bool = False
    pictures: bool | None = None
    pictures_per_s: Annotated[float, Meta(ge=0.1, le=5)] = 2.0

    def __post_init__(self) -> None:
        check_bounds(self)
        for proxy in self.proxies:
            try:
                ipaddress.ip_address(proxy)
            except ValueError:
                raise InputError("proxies", repr(proxy[:100]), "addresses") from None
        for hub in self.hubs:
            check_camera_id(hub)  # it becomes a file


@dataclass(frozen=True, slots=True)
class RecordTable:
    """`[record]`: where the views of cameras with `record` are kept, as recordings.

    Attributes:
        path: folder of the recordings.
        max_bytes: the most to keep, such as `10GB`; the oldest recordings go first.
        part_s: length of one recording, such as `10min`.
    """

    path: Path = Path("recordings")
    max_bytes: int | None = entry(None, key="max_size", read=size_bytes)
    part_s: float | None = entry(None, key="part", read=duration_s)


@dataclass(frozen=True, slots=True)
class ZoneTable:
    """`[[zone]]`: a part of the floor, with events for who enters, stays and leaves.

    Attributes:
        name: letters, digits, `-`, `_`, `.`.
        corners: x and y of its corners in metres, in order around it.
        dwell_s: stay in the zone before the event `dwell`.
        height_m: of the bed or seat that it is; somebody on it is not on the floor.
    """

    name: str = entry(write='"door"')
    corners: tuple[tuple[float, float], ...] = entry(write="[[0, 0], [1, 0], [1, 2]]")
    dwell_s: Annotated[float, Meta(ge=0, le=1e6)] = 5.0
    height_m: Annotated[float, Meta(ge=0, le=3)] = 0.0

    def __post_init__(self) -> None:
        try:
            check_camera_id(self.name)
        except InputError as error:
            raise error.at(thing="name") from None
        if not 3 <= len(self.corners) <= MAX_CORNERS:
            raise InputError("corners", f"{len(self.corners)}", f"3 to {MAX_CORNERS}")
        for x, y in self.corners:
            check_within("corners", x, -1e4, 1e4)
            check_within("corners", y, -1e4, 1e4)
        check_bounds(self)


@dataclass(frozen=True, slots=True)
class CameraTable(CameraMachine):
    """`[[camera]]`: one camera of the site, and for `e3pose up` what it sees; see `CameraMachine`.

    Attributes:
        id: its name in the calibration.
        idle_mode: what it does in slots without an order.
        source: see `camera.live_source`.
        detector: name of a detector; `recorded` for recorded sources.
        rotation: degrees clockwise that make people in its images upright, for the detector alone;
            by default what the calibration says.
        meter: how `e3pose up` lets it measure its power, `auto` or `model`, which is the default.
        budget: what it may spend, such as `4W` or `until 18:00`; by default that of the site.
        record: what of it is kept: its views as recordings, what it sees as videos, or both; by
            default nothing.
    """

    id: str = entry(write='"cam1"')
    idle_mode: IdleMode = "power-saving"
    source: str | None = None
    detector: str | None = None
    rotation: Rotation | None = None
    meter: Literal["auto", "model"] | None = None
    budget: str | None = None
    record: Literal["keypoints", "video", "both"] | None = None

    def __post_init__(self) -> None:
        try:
            check_camera_id(self.id)
        except InputError as error:
            raise error.at(thing="id") from None
        CameraMachine.__post_init__(self)
        check_source(self.source or "")


@dataclass(frozen=True, slots=True)
class SiteTable:
    """A site file; `load_site` reads one.

    Attributes:
        format: `e3pose-site`.
        version: 1.
        name: of the site.
        calibration: file of the rig.
        skeleton_name: of the poses; by default that of the cameras' detectors.
        fps: slots per second.
        pace: how fast files and recordings are played, where the machine cannot keep up: 0.1 is a
            tenth of their speed, and then slots are ten times as long.
        deadline_ms: how long after the middle of a slot its views are waited for.
        smooth_delay_ms: how much later poses are published a second time, smoothed; 0 for never.
        lead: slots between an order and the slot it is for; `adaptive` follows the delays.
        state: file that the edge goes on from after a restart; None for none, which is `""`.
        learn: folder of the online trainer; without it nothing is learned.
        budget: what each camera may spend, see `energy.budgets`; by default that of `loop` and
            `energy`.
        metrics_port: of Prometheus metrics on loopback; without it there are none.
        link: see `LinkTable`.
        store: see `StoreTable`.
        view: see `ViewTable`.
        record: see `RecordTable`.
        loop: how the loop runs.
        energy: what the cameras draw and have.
        zone: parts of the floor that are watched.
        events: what people do that is told; without the table nothing is.
        camera: the cameras; those of the calibration that are not named here have the defaults.
        path: of the file; relative ones in it start from its folder, and were found from there.

    Raises:
        InputError: naming the key, what was found and what was expected.
    """

    format: Literal["e3pose-site"] = entry()
    version: Literal[1] = entry()
    name: str = entry(write='"lab"')
    calibration: Path = entry(write='"rig.toml"')
    fps: Annotated[float, Meta(ge=0.1, le=1000)] = entry(write="25.0")
    skeleton_name: str | None = entry(None, key="skeleton")
    pace: Pace = 1.0
    deadline_ms: Annotated[float, Meta(ge=0, le=60_000)] = 150.0
    smooth_delay_ms: float = 0.0
    lead: Annotated[int, Meta(ge=1, le=60)] | Literal["adaptive"] = "adaptive"
    state: Path | None = entry(Path("state.npz"), read=read_state)
    learn: Path | None = None
    budget: str | None = None
    metrics_port: Annotated[int, Meta(ge=1, le=65535)] | None = None
    link: LinkTable = LinkTable()
    store: StoreTable | None = None
    view: ViewTable = ViewTable()
    record: RecordTable = RecordTable()
    loop: LoopSettings = LoopSettings()
    energy: EnergySettings = EnergySettings()
    zone: tuple[ZoneTable, ...] = ()
    events: EventsTable | None = None
    camera: tuple[CameraTable, ...] = ()
    path: Path = field(default=Path(SITE_FILE), metadata={"key": ""})

    def __post_init__(self) -> None:
        check_bounds(self)
        check_smooth_delay(self.smooth_delay_ms, self.loop.pipeline)
        try:
            check_site(self.name)
        except InputError as error:
            raise error.at(thing="name") from None
        names = [zone.name for zone in self.zone]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"zone {name}", "twice", "once")
        ids = [camera.id for camera in self.camera]
        for camera_id in ids:
            if ids.count(camera_id) > 1:
                raise InputError(f"camera {camera_id}", "twice", "once")

    @property
    def folder(self) -> Path:
        """Where the file is, and what the site's programs write."""
        return self.path.parent

    @property
    def keys(self) -> Path:
        """Folder of the certificates, made or to be made."""
        return self.link.keys or self.folder / "keys"


def load_site(named: Path) -> SiteTable:
    """Return the configuration of a site.

    Args:
        named: the file, or the folder that has it as `site.toml`.

    Raises:
        InputError: naming the file, the key, what was found and what was expected.
    """
    path = Path(named)
    if path.is_dir():
        path = path / SITE_FILE
        if not path.exists():
            found = f"a folder without {SITE_FILE}"
            if (Path(named) / "recording.toml").exists():
                found = "a recording"
            raise InputError(str(named), found, f"a site, made by e3pose init with its {SITE_FILE}")
    if not path.exists():
        raise InputError(
            f"{path}: file not found, expected a site file or its folder; create one with "
            f"e3pose init {shell(path.parent if path.suffix else path)}"
        )
    table = read_toml(path, MAX_BYTES)
    try:
        return read_site(table, path)
    except InputError as error:
        raise error.at(path) from None


def read_site(table: Mapping[str, object], path: Path) -> SiteTable:
    """Return the configuration that a parsed site file holds; errors are without its name.

    Raises:
        InputError: naming the key that is unknown, missing or wrong.
    """
    loop = table.get("loop")
    if isinstance(loop, Mapping) and "lead" in loop:
        raise InputError("loop.lead", "it in [loop]", "lead at the top, a number or adaptive")
    site, folder = placed(read_table(SiteTable, table), path.parent), path.parent
    cameras = tuple(_placed_camera(camera, folder) for camera in site.camera)
    loop = replace(
        site.loop,
        lead_slots=site.lead if isinstance(site.lead, int) else 1,
        pipeline=own_beside(site.loop.pipeline, folder),
        policy=_maybe_beside(folder, site.loop.policy),
        predictor=_maybe_beside(folder, site.loop.predictor),
        noise=_maybe_beside(folder, site.loop.noise),
    )
    profile = site.energy.profile.map(lambda name: beside(folder, name))
    energy = replace(site.energy, profile=profile)
    events = site.events
    if events is not None:
        kinds = tuple(own_beside(kind, folder) for kind in events.kinds)
        events = replace(events, kinds=kinds)
    return replace(site, path=path, camera=cameras, loop=loop, energy=energy, events=events)


def _placed_camera(camera: CameraTable, folder: Path) -> CameraTable:
    """Return a camera whose source and own network are given by their places."""
    try:
        source = camera.source and located(camera.source, partial(near, folder))
        detector = camera.detector and beside(folder, camera.detector)
    except InputError as error:
        raise error.under(f"camera {camera.id}") from None
    return replace(camera, source=source, detector=detector)


def _maybe_beside(folder: Path, named: T) -> T | str:
    return beside(folder, named) if isinstance(named, str) else named
