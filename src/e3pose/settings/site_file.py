"""The configuration of a site and of a camera: TOML files, every key known, every path relative.

`docs/live.md` describes both. Keys of `[loop]` and `[energy]` are the options of `e3pose replay`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from e3pose.errors import InputError
from e3pose.files.bounded import read_toml
from e3pose.files.misfit import misfit
from e3pose.geometry.camera import Rig, check_camera_id
from e3pose.wire.access import split_endpoint
from e3pose.wire.topics import check_site

MAX_BYTES = 2**20
SITE_FILE = "site.toml"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
IdleMode = Literal["power-saving", "aggressive-power-saving"]


class LinkTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[link]`: where the edge listens.

    Attributes:
        endpoint: `tls/HOST:PORT`, or `tcp/HOST:PORT` on loopback.
        keys: folder of `e3pose keys`, for tls.
        upstream: routers to join, where sites share them.
        insecure: whether plain tcp beyond this machine is allowed.
    """

    endpoint: str = DEFAULT_ENDPOINT
    keys: str | None = None
    upstream: tuple[str, ...] = ()
    insecure: bool = False


class StoreTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[store]`: where every slot is kept.

    Attributes:
        path: a file (SQLite) or the URL of a database.
        keep: the oldest to keep, such as `30d`.
        max_size: the most to keep, such as `20GB`.
    """

    path: str
    keep: str | None = None
    max_size: str | None = None


class CameraTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[[camera]]`: one camera of the site, and for `e3pose up` what it sees.

    Attributes:
        id: its name in the calibration.
        idle_mode: what it does in slots without an order.
        source: see `node.live_source`.
        detector: name of a detector; `recorded` for recorded sources.
        model: file of the network.
        provider: where it runs.
        threads: of the processor for the network; all cores by default.
        wake_s: seconds from aggressive power-saving to its first frame.
        battery_wh: capacity; without it the camera is on mains.
        meter: how `e3pose up` lets it measure its power, `auto` or `model`, which is the default.
        budget: what it may spend, such as `4W` or `until 18:00`; by default that of the site.
    """

    id: str
    idle_mode: IdleMode = "power-saving"
    source: str | None = None
    detector: str | None = None
    model: str | None = None
    provider: str = "auto"
    threads: int | None = None
    wake_s: float = 0.5
    battery_wh: float | None = None
    meter: Literal["auto", "model"] | None = None
    budget: str | None = None


class SiteTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A site file.

    Attributes:
        format: `e3pose-site`.
        version: 1.
        name: of the site.
        calibration: file of the rig.
        skeleton: of the detectors.
        fps: slots a second.
        pace: how fast files and recordings are played, where the machine cannot keep up: 0.1 is a
            tenth of their speed, and then slots are ten times as long.
        deadline_ms: how long after the middle of a slot its views are waited for.
        smooth_delay_ms: how much later poses are published a second time, smoothed; 0 for never.
        lead: slots between an order and the slot it is for; `adaptive` follows the delays.
        state: file that the edge goes on from after a restart; empty for none.
        learn: folder of the online trainer; without it nothing is learned.
        budget: what each camera may spend, see `power.budgets`; by default that of `loop` and
            `energy`.
        metrics_port: of Prometheus metrics on loopback; without it there are none.
        link: see `LinkTable`.
        store: see `StoreTable`.
        loop: options of the loop, see `e3pose replay --help`.
        energy: options of the energy, likewise.
        camera: the cameras; those of the calibration that are not named here have the defaults.
    """

    format: Literal["e3pose-site"]
    version: Literal[1]
    name: str
    calibration: str
    fps: float
    skeleton: str = "coco17"
    pace: float = 1.0
    deadline_ms: float = 150.0
    smooth_delay_ms: float = 0.0
    lead: int | Literal["adaptive"] = "adaptive"
    state: str = "state.npz"
    learn: str | None = None
    budget: str | None = None
    metrics_port: int | None = None
    link: LinkTable = LinkTable()
    store: StoreTable | None = None
    loop: dict[str, Any] = {}
    energy: dict[str, Any] = {}
    camera: tuple[CameraTable, ...] = ()


class NodeTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A camera file; the options of `e3pose camera` take precedence.

    Attributes:
        format: `e3pose-camera`.
        version: 1.
        site: name of the site.
        camera: its id there.
        source: see `node.live_source`.
        endpoint: of the edge.
        keys: folder that `e3pose keys add` made, for tls.
        insecure: whether plain tcp beyond this machine is allowed.
        detector: name of a detector.
        model: file of the network.
        provider: where it runs.
        threads: of the processor for the network; all cores by default.
        fps: frames a second to ask of the source; None for its own.
        pace: how fast a file or recording is played.
        begin_s: seconds since 1970 at which a round of it begins, and before which nothing is
            shown; by default rounds are counted from 1970.
        wake_s: seconds from aggressive power-saving to the first frame.
        battery_wh: capacity; without it the camera is on mains.
        meter: how its power is measured.
        profile: power profile, for what is not measured.
        state: file that remembers the charge of a battery without a gauge; empty for none.
    """

    format: Literal["e3pose-camera"]
    version: Literal[1]
    site: str
    camera: str
    source: str
    endpoint: str = DEFAULT_ENDPOINT
    keys: str | None = None
    insecure: bool = False
    detector: str = "movenet-multipose"
    model: str | None = None
    provider: str = "auto"
    threads: int | None = None
    fps: float | None = None
    pace: float = 1.0
    begin_s: float = 0.0
    wake_s: float = 0.5
    battery_wh: float | None = None
    meter: Literal["auto", "model"] = "auto"
    profile: str = "xavier-nx"
    state: str | None = None


def open_site(named: Path) -> tuple[Path, SiteTable]:
    """Return the site file that is meant, and what it says.

    Args:
        named: the file, or the folder that has it as `site.toml`.

    Raises:
        InputError: as `load_site`.
    """
    path = named
    if named.is_dir():
        path = named / SITE_FILE
        if not path.exists():
            raise InputError(
                f"{named}: found a folder without {SITE_FILE}, expected one that has it"
            )
    return path, load_site(path)


def load_site(path: Path) -> SiteTable:
    """Return the configuration of a site.

    Raises:
        InputError: naming the file, the key, what was found and what was expected.
    """
    try:
        site = msgspec.convert(read_toml(path, MAX_BYTES), SiteTable)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {misfit(error, SiteTable)}") from None
    where = f"{path}: "
    _within(where, "fps", site.fps, 0.1, 1000)
    _within(where, "deadline_ms", site.deadline_ms, 0, 60_000)
    _within(where, "smooth_delay_ms", site.smooth_delay_ms, 0, 2_000)
    if site.smooth_delay_ms and site.loop.get("pipeline") == "paper":
        raise InputError(
            f"{where}: smooth_delay_ms: found it with pipeline paper, expected memory: the paper's "
            "estimator has nothing to smooth with"
        )
    _within(where, "pace", site.pace, 1e-3, 1)
    if isinstance(site.lead, int):
        _within(where, "lead", site.lead, 1, 60)
    if site.metrics_port is not None:
        _within(where, "metrics_port", site.metrics_port, 1, 65535)
    _named(path, lambda: check_site(site.name))
    _named(path, lambda: split_endpoint(site.link.endpoint))
    seen: set[str] = set()
    for camera in site.camera:
        _named(path, lambda camera=camera: check_camera_id(camera.id))
        if camera.id in seen:
            raise InputError(f"{path}: camera {camera.id}: found twice, expected once")
        seen.add(camera.id)
        where = f"{path}: camera {camera.id}: "
        _check_camera(where, camera.wake_s, camera.battery_wh, camera.threads)
    if site.state and not site.state.endswith(".npz"):  # it is replaced again and again
        raise InputError(
            f"{path}: state: found {site.state[:80]!r}, expected a name that ends in .npz, or ''"
        )
    return site


def load_node(path: Path | None, options: Mapping[str, Any]) -> NodeTable:
    """Return the configuration of a camera.

    Args:
        path: of the camera file; None for options alone.
        options: keys of the file that take precedence over it.

    Raises:
        InputError: as `load_site`, but without the file where an option is meant.
    """
    table: dict[str, Any] = {"format": "e3pose-camera", "version": 1}
    if path is not None:
        table = read_toml(path, MAX_BYTES)
    try:
        return _node({**table, **options})
    except InputError as error:
        asked = any(str(error).startswith((f"{key}:", f"{key} ")) for key in options)
        raise error if asked or path is None else InputError(f"{path}: {error}") from None


def _node(table: Mapping[str, Any]) -> NodeTable:
    try:
        node = msgspec.convert(table, NodeTable)
    except msgspec.ValidationError as error:
        raise InputError(misfit(error, NodeTable)) from None
    check_site(node.site)
    check_camera_id(node.camera)
    split_endpoint(node.endpoint)
    if node.fps is not None:
        _within("", "fps", node.fps, 0.1, 1000)
    _within("", "pace", node.pace, 1e-3, 1)
    _within("", "begin_s", node.begin_s, 0, 1e10)
    _check_camera("", node.wake_s, node.battery_wh, node.threads)
    if node.state and not node.state.endswith(".json"):  # it is replaced again and again
        found = f"state: found {node.state[:80]!r}"
        raise InputError(f"{found}, expected a name that ends in .json, or ''")
    return node


def cameras_of(path: Path, site: SiteTable, rig: Rig) -> dict[str, CameraTable]:
    """Return the configuration of every camera of the rig, in its order.

    Raises:
        InputError: when the site names a camera that the calibration does not have.
    """
    named = {camera.id: camera for camera in site.camera}
    for camera_id in named:
        if camera_id not in rig.camera_ids:
            raise InputError(
                f"{path}: camera {camera_id}: not in the calibration, "
                f"expected one of {', '.join(rig.camera_ids)[:300]}"
            )
    return {i: named.get(i) or CameraTable(i) for i in rig.camera_ids}


def store_place(path: Path, store: StoreTable) -> Path | str:
    """Return the file or the URL of a site's store."""
    return store.path if "://" in store.path else beside(path, store.path)


def beside(path: Path, name: str) -> Path:
    """Return the place that a name in a configuration file means: relative to the file.

    Raises:
        InputError: for what can name no file.
    """
    try:
        return place(path.parent, name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def place(folder: Path, name: str) -> Path:
    """Return the place that a name means, relative to a folder; `~` is the user's home."""
    if not name.isprintable():
        raise InputError(f"found {name[:80]!r}, expected the name of a file or folder")
    try:
        return folder / Path(name).expanduser()
    except RuntimeError:  # `~somebody`
        raise InputError(f"found {name[:80]!r}, expected the home of a user there is") from None


def _within(where: str, key: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # NaN fails too
        raise InputError(f"{where}{key}: found {value:g}, expected {low:g} to {high:g}")


def _check_camera(where: str, wake_s: float, battery_wh: float | None, threads: int | None) -> None:
    _within(where, "wake_s", wake_s, 0, 3600)
    if threads is not None:
        _within(where, "threads", threads, 1, 1024)
    if battery_wh is not None:
        _within(where, "battery_wh", battery_wh, 1e-3, 1e6)


def _named(path: Path, check: Any) -> None:
    try:
        check()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def options_from(path: Path, table: str, found: Mapping[str, Any], known: Any) -> Any:
    """Return the options of a dataclass that a table of a site file sets.

    Args:
        path: of the file, for errors.
        table: its name, for errors.
        found: its keys, written with `_` or `-` as on the command line.
        known: the dataclass.

    Raises:
        InputError: for an unknown key or a value of another type.
    """
    from dataclasses import fields

    plain = {key.replace("-", "_"): value for key, value in found.items()}
    if len(plain) < len(found):
        raise InputError(f"{path}: {table}: found a key twice, once with - and once with _")
    names = [item.name for item in fields(known)]
    for key in plain:
        if key not in names:
            raise InputError(
                f"{path}: {table}: unknown key {key[:60]!r}, expected one of {', '.join(names)}"
            )
    try:
        return msgspec.convert(plain, known)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {table}: {misfit(error, known)}") from None
