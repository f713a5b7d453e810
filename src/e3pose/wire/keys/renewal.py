"""Renew certificates before they expire, without revoking those in use."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.wire.access import edge_name
from e3pose.wire.keys.folder import LIST, MAX_PEM_BYTES, WAIT_S, issue, read_roll

SOON_DAYS = 30
EDGE, AUTHORITY = "edge", "authority"


def certificate_files(folder: Path) -> dict[str, Path]:
    """Return the certificates in a folder of keys by name, the edge's first.

    A folder that was moved to its machine is not there any more, and is left out.

    Raises:
        InputError: when the list of the folder cannot be read.
    """
    roll = read_roll(folder)
    found = {EDGE: folder / "edge.pem"}
    for kind, names in roll.holders.items():
        for name in names:
            found[name] = folder / f"{kind}s" / name / f"{kind}.pem"
    return {name: path for name, path in found.items() if path.is_file()}


def expiring(folder: Path, now: datetime.datetime) -> Iterator[tuple[str, datetime.datetime]]:
    """Yield name and end of the certificates that expire soon, or have expired.

    Args:
        folder: of the site's keys.
        now: the time, UTC.

    Raises:
        InputError: when the list of the folder cannot be read.
    """
    from e3pose.wire.keys.authority import expires

    for name, path in {AUTHORITY: folder / "authority.pem", **certificate_files(folder)}.items():
        try:
            until = expires(read_bytes(path, MAX_PEM_BYTES))
        except InputError:
            continue  # being replaced
        if until - now < datetime.timedelta(days=SOON_DAYS):
            yield name, until


def renewal_advice(name: str) -> str:
    """Return the command that makes a certificate last longer."""
    return "e3pose keys init a new folder" if name == AUTHORITY else f"e3pose keys renew {name}"


def renew_keys(folder: Path, name: str, now: datetime.datetime) -> Path:
    """Make a new certificate for the edge, a camera, a viewer, an operator, a hub or a router.

    It has the name, the hosts and the private key of the old one, which stays valid until it
    expires; the private key of a camera may be there alone. One file changes, so that a kill leaves
    the old pair or the new one.

    Args:
        folder: of the site's keys.
        name: `edge`, or of the holder.
        now: the time from which it is valid.

    Returns:
        The folder of the new certificate, to carry to its machine.

    Raises:
        InputError: when there is none of that name, or the authority's key is not there.
    """
    from e3pose.wire.keys.authority import UNREADABLE, common_name, hosts_of, public_of

    with hold(folder / LIST, wait_s=WAIT_S):
        files = certificate_files(folder)
        if name not in files:
            raise InputError(
                f"{folder}: found no certificate of {name[:80]}, "
                f"expected one of: {', '.join(files)}; e3pose keys add makes a new one"
            )
        path = files[name]
        old = read_bytes(path, MAX_PEM_BYTES)
        try:
            subject, hosts = common_name(old), hosts_of(old)
        except UNREADABLE:
            wanted = "expected what `e3pose keys` made"
            raise InputError(f"{path}: found no certificate, {wanted}") from None
        _check_subject(folder, name, subject)
        place = path.with_suffix(".key")
        own, theirs = read_bytes(place, MAX_PEM_BYTES) if place.is_file() else b"", None
        if path.stem == "camera" and not place.exists():
            theirs = public_of(old)
        made, private = issue(folder, subject, hosts, now, own, theirs)
        if private != own:  # there was none that can be read
            write_file(place, private, private=True)
        write_file(path, made)
    return path.parent


def _check_subject(folder: Path, name: str, subject: str) -> None:
    """Raise `InputError` for a file that holds another one's certificate."""
    roll = read_roll(folder)
    given = [names[name] for names in roll.holders.values() if name in names]
    wanted = [edge_name(roll.site)] if name == EDGE else given
    if subject not in wanted:
        raise InputError(
            f"{folder}: the certificate of {name} is that of {subject[:80]}, "
            f"expected {wanted[0]}: e3pose keys add {name} --again"
        )
