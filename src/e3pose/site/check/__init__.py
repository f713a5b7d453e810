"""Check a site before it runs: problems, warnings, and how to fix them."""

from __future__ import annotations

import datetime
import glob
import shutil
import socket
import stat
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.edge.rests import sleeps_as_told
from e3pose.model.blind_slot import blind_words
from e3pose.model.camera import Rig
from e3pose.settings.resolved import ResolvedSite, calibrate_advice
from e3pose.settings.site_file import SiteTable
from e3pose.site.admission import edge_link
from e3pose.wire.access import Roll
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.keys.folder import Kind, valid_certificates
from e3pose.wire.keys.renewal import SOON_DAYS
from e3pose.wire.site_messages import CameraStatus, Status

APART_M = 0.1  # cameras nearer to each other than this see the same
CLOCK_MS = 5.0
FREE_BYTES = 10**9
LISTEN_S = 1.0  # to find out whether a port is taken
BLIND_SHARE = 0.02  # of the last minute's slots
STORE_CHECK_S = 5.0  # at its database

Level = Literal["ok", "warning", "problem"]


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        level: how it is.
        what: what was checked.
        found: how it was found.
        advice: what to do about it; empty if nothing.
    """

    level: Level
    what: str
    found: str
    advice: str = ""


def uncalibrated(site: ResolvedSite) -> Finding:
    """Return the finding of a site without camera positions."""
    file = site.calibration
    found = f"{file} has lenses, but no places" if file.exists() else f"{file} is missing"
    return Finding("problem", "calibration", found, calibrate_advice(site))


def check_calibration(rig: Rig) -> Iterator[Finding]:
    """Check where the cameras are, and whether they see the same."""
    centres = np.array([camera.T_world_camera[:3, 3] for camera in rig.cameras])
    axes = np.array([camera.T_world_camera[:3, 2] for camera in rig.cameras])
    yield Finding("ok", "calibration", plural(len(rig), "camera"))
    if len(rig) < 2:
        yield Finding("problem", "calibration", "one camera", "3D needs at least two cameras")
        return
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    for a, b in np.argwhere(np.triu(distance < APART_M)).tolist():
        yield Finding(
            "warning",
            "calibration",
            f"{rig.camera_ids[a]} and {rig.camera_ids[b]} are {distance[a, b] * 100:.0f} cm apart",
            "cameras in one place share one view; check the calibration",
        )
    spread = float(np.ptp(centres, axis=0).max())
    if spread > 200:
        yield Finding(
            "problem",
            "calibration",
            f"cameras are {spread:.0f} m apart",
            "the calibration is probably in millimetres or centimetres; set its units",
        )
    sees = _seen_by(rig, centres, axes)
    for camera_id, others in zip(rig.camera_ids, sees.tolist(), strict=True):
        if others == 0:
            yield Finding(
                "warning",
                "calibration",
                f"{camera_id} does not overlap with any other camera",
                "check its extrinsics; people seen by one camera only get no 3D pose",
            )
    up = centres[:, 2]
    if (up < -0.5).any():
        low = [i for i, z in zip(rig.camera_ids, up.tolist(), strict=True) if z < -0.5]
        yield Finding(
            "warning",
            "calibration",
            f"{', '.join(low)} below the floor",
            "z must point up, with the floor at z = 0",
        )


def _seen_by(rig: Rig, centres: Floats, axes: Floats) -> NDArray[np.int64]:
    """Return `(num_cameras,)`: cameras that see a point that this one sees, 2 to 8 m ahead."""
    depth = np.linspace(2.0, 8.0, 13)[:, None, None]
    points = centres + depth * axes  # (num_depths, num_cameras, 3)
    counts = np.zeros(len(rig), dtype=np.int64)
    for index, camera in enumerate(rig.cameras):
        pixels, ahead = camera.project(points), (points - centres[index]) @ axes[index] > 0.1
        inside = ((pixels >= 0) & (pixels < np.array(camera.image_size))).all(axis=-1) & ahead
        seen = inside.any(axis=0)
        seen[index] = False
        counts += seen
    return counts


def check_link_of(site: ResolvedSite) -> Iterator[Finding]:
    """Check the endpoint and the certificates."""
    try:
        _, roll = edge_link(site)
    except InputError as error:
        advice = ""
        if site.link.endpoint.encrypted:
            folder = site.keys
            if not (folder / "keys.toml").exists():
                advice = f"e3pose keys init {site.name} --out {folder}"
            if site.link.keys is None:
                advice += f"{', and ' if advice else ''}keys = 'keys' in [link]"
        yield Finding("problem", "link", str(error), advice)
        return
    yield Finding("ok", "link", str(site.link.endpoint))
    if not site.link.endpoint.encrypted:
        if site.link.insecure:
            yield Finding(
                "warning",
                "link",
                "unencrypted tcp: anyone on the network can read and forge messages",
                f"e3pose keys init {site.name}, and endpoint = 'tls/...'",
            )
        return
    if site.link.endpoint.host in ("127.0.0.1", "localhost"):
        yield Finding(
            "warning", "link", "reachable from this machine only", "endpoint = 'tls/0.0.0.0:7447'"
        )
    folder = site.keys
    now = datetime.datetime.now(datetime.timezone.utc)
    yield from _lasting(folder, site.name, roll, now)
    for camera_id in site.rig.camera_ids:
        if roll is None or camera_id not in roll.cameras:
            yield Finding(
                "problem",
                f"certificate {camera_id}",
                "missing",
                f"e3pose keys add {camera_id} --keys {folder}, then copy its folder to the camera",
            )
            continue
        yield _certificate(folder / "cameras" / camera_id, camera_id, now)


def _lasting(
    folder: Path, name: str, roll: Roll | None, now: datetime.datetime
) -> Iterator[Finding]:
    """Check the certificates of the edge, its authority, viewers, operators, hubs, routers."""
    from e3pose.wire.keys.authority import expires

    anew = f"e3pose keys init {name} --out {folder}-new, then copy all its folders"
    renew = f"e3pose keys renew edge --keys {folder}"
    for what, file, advice in (
        ("authority", "authority.pem", anew),
        ("edge", "edge.pem", renew),
    ):
        until = expires((folder / file).read_bytes())  # that they are valid now was checked
        if until - now < datetime.timedelta(days=SOON_DAYS):
            yield Finding("warning", f"certificate {what}", f"expires on {until:%Y-%m-%d}", advice)
    kinds: dict[Kind, Mapping[str, str]] = {}
    if roll is not None:
        kinds = {
            "viewer": roll.viewers, "operator": roll.operators, "hub": roll.hubs,
            "router": roll.routers,
        }  # fmt: skip
    for kind, names in kinds.items():
        for one in names:
            place = folder / f"{kind}s" / one
            if place.is_dir():  # it may have been moved to its machine, not copied
                yield _certificate(place, one, now, kind)


def _certificate(
    folder: Path,
    name: str,
    now: datetime.datetime,
    kind: Kind = "camera",
) -> Finding:
    from e3pose.wire.keys.authority import expires

    what = f"certificate {name}"
    option = "" if kind == "camera" else f" --{kind}"
    again = (
        f"e3pose keys add {name}{option} --again --keys {folder.parent.parent}, then copy {folder}"
    )
    try:
        files = valid_certificates(folder, kind)
    except InputError as error:
        return Finding("problem", what, str(error), again)
    until = expires(files.certificate.read_bytes())
    if until - now < datetime.timedelta(days=SOON_DAYS):
        renew = f"e3pose keys renew {name} --keys {folder.parent.parent}, then copy {folder}"
        return Finding("warning", what, f"expires on {until:%Y-%m-%d}", renew)
    return Finding("ok", what, f"valid until {until:%Y-%m-%d}")


def check_places(site: SiteTable) -> Iterator[Finding]:
    """Check the folders that the edge writes to."""
    store = None if site.store is None else site.store.place
    for what, file in (("state", site.state), ("store", store)):
        if not isinstance(file, Path):
            continue
        folder = file.resolve().parent
        if not folder.is_dir():
            yield Finding("problem", what, f"{folder} does not exist", f"mkdir -p {folder}")
            continue
        free = shutil.disk_usage(folder).free
        if free < FREE_BYTES:
            yield Finding(
                "warning",
                what,
                f"{free / 1e9:.1f} GB free in {folder}",
                "free disk space, or set keep and max_size in [store]",
            )
        else:
            yield Finding("ok", what, f"{free / 1e9:.0f} GB free in {folder}")
        yield from _readers(what, file)
    if store is None:
        yield Finding(
            "warning", "store", "no [store]: poses are not stored", "[store] path = 'poses.db'"
        )
    elif isinstance(store, Path):
        yield from check_store(store)
    else:
        yield check_server(store)


def _readers(what: str, file: Path) -> Iterator[Finding]:
    try:
        everybody = file.stat().st_mode & stat.S_IROTH
    except OSError:
        return
    if everybody:
        found = f"readable by every user of this machine: {file}"
        yield Finding("warning", what, found, f"chmod o-rwx {file}*")


def check_store(file: Path) -> Iterator[Finding]:
    """Check the integrity of the database for some seconds, and report damaged ones set aside."""
    from e3pose.store.integrity import problem_of

    if file.is_file() and (problem := problem_of(file, STORE_CHECK_S)):
        advice = "the edge moves it aside within minutes, or at its next start"
        yield Finding("problem", "store-corrupt", f"{file}: damaged ({problem})", advice)
    aside = [
        other
        for other in sorted(file.parent.glob(f"{glob.escape(file.name)}.corrupt-*"))
        if not other.name.endswith(("-wal", "-shm"))
    ]
    if aside:
        found = f"{plural(len(aside), 'damaged database')} moved aside, newest: {aside[-1]}"
        advice = f"recover with `sqlite3 {aside[-1]} .recover`, then delete it"
        yield Finding("warning", "store-corrupt", found, advice)


def check_server(url: str) -> Finding:
    """Check that a database server accepts connections and holds a store."""
    from e3pose.store.database import check_reachable

    try:
        return Finding("ok", "store", check_reachable(url))
    except InputError as error:
        advice = "start the server; while it is away, slots wait in the spool"
        return Finding("problem", "store", str(error), advice)


def check_clock(endpoint: Endpoint) -> Finding:
    """Check whether this machine's clock is synchronised, if cameras and edge have several.

    Args:
        endpoint: of the edge.
    """
    if endpoint.here_alone:
        return Finding("ok", "clock", "cameras and edge share this machine's clock")
    advice = "install chrony; for microseconds use PTP (linuxptp)"
    if shutil.which("chronyc"):
        answer = _ask("chronyc", "-c", "tracking").split(",")
        if len(answer) > 4 and answer[1] not in ("", "0.0.0.0"):
            found = f"synchronised by chrony to {answer[1]}, offset {answer[4]} s"
            return Finding("ok", "clock", found)
        return Finding("warning", "clock", "chrony has no server", "add a server to chrony.conf")
    if shutil.which("timedatectl"):
        if "NTPSynchronized=yes" in _ask("timedatectl", "show"):
            return Finding("ok", "clock", "synchronised by systemd-timesyncd")
        return Finding("warning", "clock", "not synchronised", advice)
    found = "no time synchronisation found; cameras measure and correct their offset"
    return Finding("warning", "clock", found, advice)


def check_running(status: Status | None, endpoint: Endpoint) -> Iterator[Finding]:
    """Check the running edge and its cameras, if there is one.

    Args:
        status: what it says; None if it does not answer.
        endpoint: where it was asked.
    """
    if status is None:
        found, advice = f"not running at {endpoint}", "e3pose edge, or e3pose up on one machine"
        host, port = endpoint.address
        if _listens(host, port):
            found = f"something listens at {endpoint}, but no edge of this site answers"
            advice = f"wait while it starts, or see whose port it is: ss -ltnp 'sport = :{port}'"
        yield Finding("warning", "edge", found, advice)
        return
    yield Finding("ok", "edge", f"running, slot {status.slot}, lead {status.lead}")
    if status.overload:
        advice = "a faster machine, fewer slots per second (fps) or fewer cameras"
        yield Finding("warning", "edge", status.overload, advice)
    if status.blind_share > BLIND_SHARE:
        found = f"{status.blind_share:.0%} of the last minute's slots blind"
        advice = f"since its start: {blind_words(status.blind)}; docs/how-to/monitor.md"
        yield Finding("warning", "edge", found, advice)
    for camera in status.cameras:
        what = f"camera {camera.camera_id}"
        if sleeps_as_told(camera):
            yield Finding("ok", what, camera.why)
        elif not camera.online:
            advice = "see its log"
            if camera.battery == 0 and not camera.gauge:
                advice = "charge it, then delete NAME.battery.json beside its camera file"
            yield Finding("problem", what, camera.why, advice)
        elif camera.turned_deg is not None:
            found = f"has moved: turned by {camera.turned_deg:.1f} degrees or more"
            advice = f"e3pose calibrate extrinsics SITE --only {camera.camera_id}"
            yield Finding("warning", what, found, advice)
        elif camera.why:
            yield Finding("warning", what, camera.why)
        elif abs(camera.clock_offset_ms) > CLOCK_MS:
            found = f"clock offset {camera.clock_offset_ms:+.1f} ms"
            yield Finding("warning", what, found, "corrected; for fast motion use chrony or PTP")
        else:
            yield Finding("ok", what, _connected_words(camera))


def _connected_words(camera: CameraStatus) -> str:
    words = f"connected, clock offset {camera.clock_offset_ms:+.1f} ms"
    if camera.unchanged is None:
        return words
    return f"{words}, image unchanged in {camera.unchanged:.0%} of its looks"


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), LISTEN_S).close()
    except OSError:
        return False
    return True


def _ask(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout
