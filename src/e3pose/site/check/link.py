"""Check the endpoint of an edge and all certificates."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.admission import edge_link
from e3pose.site.check.finding import Finding
from e3pose.wire.access import Kind, Roll
from e3pose.wire.keys.folder import valid_certificates
from e3pose.wire.keys.renewal import SOON_DAYS


def check_link_of(site: ResolvedSite) -> Iterator[Finding]:
    """Check the endpoint and the certificates."""
    try:
        _, roll = edge_link(site.file)
    except InputError as error:
        advice = ""
        if site.file.link.endpoint.encrypted:
            folder = site.file.keys
            if not (folder / "keys.toml").exists():
                advice = f"e3pose keys init {site.file.name} --out {folder}"
            if site.file.link.keys is None:
                advice += f"{', and ' if advice else ''}keys = 'keys' in [link]"
        yield Finding("problem", "link", str(error), advice)
        return
    yield Finding("ok", "link", str(site.file.link.endpoint))
    if not site.file.link.endpoint.encrypted:
        if site.file.link.insecure:
            yield Finding(
                "warning",
                "link",
                "unencrypted tcp: anyone on the network can read and forge messages",
                f"e3pose keys init {site.file.name}, and endpoint = 'tls/...'",
            )
        return
    if site.file.link.endpoint.host in ("127.0.0.1", "localhost"):
        yield Finding(
            "warning", "link", "reachable from this machine only", "endpoint = 'tls/0.0.0.0:7447'"
        )
    folder = site.file.keys
    now = datetime.datetime.now(datetime.timezone.utc)
    yield from _lasting(folder, site.file.name, roll, now)
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
        found = expiry(f"certificate {what}", until, now, advice)
        if found.level != "ok":
            yield found
    for kind, names in ({} if roll is None else roll.holders).items():
        for one in names:
            place = folder / f"{kind}s" / one
            if kind != "camera" and place.is_dir():  # it may have been moved, not copied
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
    renew = f"e3pose keys renew {name} --keys {folder.parent.parent}, then copy {folder}"
    return expiry(what, expires(files.certificate.read_bytes()), now, renew)


def expiry(what: str, until: datetime.datetime, now: datetime.datetime, renew: str) -> Finding:
    """Return whether a certificate lasts, and how to renew one that does not."""
    if until - now < datetime.timedelta(days=SOON_DAYS):
        return Finding("warning", what, f"expires on {until:%Y-%m-%d}", renew)
    return Finding("ok", what, f"valid until {until:%Y-%m-%d}")
