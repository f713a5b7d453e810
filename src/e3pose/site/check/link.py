"""Problems of an edge's endpoint, certificates and the clock."""

from __future__ import annotations

import datetime
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.admission import edge_link
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.wire.access import Roll
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.keys.folder import valid_certificates
from e3pose.wire.keys.renewal import AUTHORITY, EDGE, expiring

CLOCK_MS = 5.0  # of a clock, before it is said


def link_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield the problems of the endpoint and of all programs' certificates."""
    table, folder = site.file.link, site.file.keys
    try:
        _, roll = edge_link(site.file)
    except InputError as error:
        advice = []
        if table.endpoint.encrypted and not (folder / "keys.toml").exists():
            advice.append(f"e3pose keys init {site.file.name} --out {shell(folder)}")
        if table.endpoint.encrypted and table.keys is None:
            advice.append("keys = 'keys' in [link]")
        yield problem("link", str(error), ", and ".join(advice))
        return
    if not table.endpoint.encrypted:
        if table.insecure:
            found = "unencrypted tcp: anyone on the network can read and forge messages"
            yield warning(
                "link", found, f"e3pose keys init {site.file.name}, and endpoint = 'tls/...'"
            )
        return
    if table.endpoint.host in ("127.0.0.1", "localhost"):
        found = "reachable from this machine only"
        yield warning("link", found, "endpoint = 'tls/0.0.0.0:7447'")
    for camera_id in site.rig.camera_ids:
        if roll is None or camera_id not in roll.cameras:
            how = f"e3pose keys add {camera_id} --keys {shell(folder)}, then copy its folder there"
            yield problem(f"certificate {camera_id}", "missing", how)
    if roll is not None:
        yield from _certificates(folder, roll, site.file.name)


def _certificates(folder: Path, roll: Roll, site: str) -> Iterator[Finding]:
    """Yield certificates that are invalid or expire soon."""
    refused = set()
    for kind, names in roll.holders.items():
        for name in names:
            place = folder / f"{kind}s" / name
            if kind != "camera" and not place.is_dir():
                continue  # it may have been moved, not copied
            if (place / "camera.pem").exists() and not (place / "camera.key").exists():
                continue  # the key never left the camera
            try:
                valid_certificates(place, kind)
            except InputError as error:
                refused.add(name)
                option = "" if kind == "camera" else f" --{kind}"
                command = f"e3pose keys add {name}{option} --again --keys {shell(folder)}"
                again = f"{command}, then copy {place}"
                yield problem(f"certificate {name}", str(error), again)
    for name, until in expiring(folder, datetime.datetime.now(datetime.timezone.utc)):
        if name in refused:
            continue
        renew = f"e3pose keys renew {name} --keys {shell(folder)}"
        if name == AUTHORITY:
            renew = (
                f"e3pose keys init {site} --out {shell(f'{folder}-new')}, then copy all its folders"
            )
        elif name != EDGE:
            renew += ", then copy its folder"
        yield warning(f"certificate {name}", f"expires on {until:%Y-%m-%d}", renew)


def clock_problems(endpoint: Endpoint) -> Iterator[Finding]:
    """Yield whether this machine's clock is synchronised, if cameras and edge have several.

    Args:
        endpoint: of the edge.
    """
    if endpoint.here_alone:
        return
    advice = "install chrony; for microseconds use PTP (linuxptp)"
    if shutil.which("chronyc"):
        answer = _ask("chronyc", "-c", "tracking").split(",")
        if len(answer) > 4 and answer[1] not in ("", "0.0.0.0"):
            yield ok("clock", f"synchronised by chrony to {answer[1]}, offset {answer[4]} s")
        else:
            yield warning("clock", "chrony has no server", "add a server to chrony.conf")
    elif not shutil.which("timedatectl"):
        found = "no time synchronisation found; cameras measure and correct their offset"
        yield warning("clock", found, advice)
    elif "NTPSynchronized=yes" in _ask("timedatectl", "show"):
        yield ok("clock", "synchronised by systemd-timesyncd")
    else:
        yield warning("clock", "not synchronised", advice)


def _ask(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout
