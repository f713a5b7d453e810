"""The folder of a site's certificates, and the roles of their holders.

    keys/
      keys.toml                 who there is: camera id -> common name, and who was revoked
      authority.pem, .key       stay on this machine
      edge.pem, .key            of the edge server
      cameras/CAMERA/           carry it to the camera: authority.pem, camera.pem, camera.key
      viewers/VIEWER/           likewise, for programs that only look
      operators/OPERATOR/       likewise, for programs that also control the edge
      hubs/HUB/                 likewise, for a hub, which fetches summaries and sees nobody
      routers/ROUTER/           likewise, for a router before the edge, with a copy of keys.toml

A common name holds a number that grows (`cam1#2`): a camera that was revoked and added again is
somebody else, and the old certificate stays worthless. Access is by these names, so revoking needs
no more than a line in this list.
"""

from __future__ import annotations

import datetime
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tomli_w

from e3pose.base.atomic import atomic_folder, check_free, write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.private import make_folder
from e3pose.base.quantities import check_within
from e3pose.base.table import entry, read_file
from e3pose.model.camera_fields import check_camera_id
from e3pose.wire.access import Certificates, Kind, Link, Roll, check_link, edge_name, holder_of
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.topics import check_site

LIST = "keys.toml"
WAIT_S = 5.0  # for another program that changes the list
MAX_LIST_BYTES = 2**20
MAX_PEM_BYTES = 2**16
HOST = re.compile(r"[A-Za-z0-9.:-]{1,253}")
COMMON_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,51}#([0-9]{1,9})")
MAX_COUNT = 10**9 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Listed(Roll):
    """A roll as its file has it; every common name is given once."""

    format: Literal["e3pose-keys"] = entry()
    version: Literal[1] = entry()

    def __post_init__(self) -> None:
        check_site(self.site)
        check_within("count", self.count, 0, MAX_COUNT)
        for names in self.holders.values():
            for name in names:
                check_camera_id(name)
        given = self.common_names
        for name in given:
            if not COMMON_NAME.fullmatch(name):
                raise InputError("", repr(name[:80]), "a common name such as cam1#2")
        if len(set(given)) < len(given):
            twice = next(name for name in given if given.count(name) > 1)
            raise InputError("", f"{twice} twice", "one name for each certificate")


def not_admitted(roll: Roll | None, camera_ids: Sequence[str]) -> dict[str, str]:
    """Return the cameras that cannot join a site, and why.

    Args:
        roll: the holders of certificates; None where the site has none.
        camera_ids: of the site.

    Returns:
        Camera id to the reason and what to do.
    """
    if roll is None:
        return {}
    revoked = {common_name.rpartition("#")[0] for common_name in roll.revoked}
    return {
        camera_id: f"{'certificate revoked' if camera_id in revoked else 'no certificate'}: "
        f"e3pose keys add {camera_id}"
        for camera_id in camera_ids
        if camera_id not in roll.cameras
    }


def init_keys(folder: Path, site: str, hosts: Sequence[str], now: datetime.datetime) -> Roll:
    """Make the authority of a new site and the certificate of its edge server.

    Args:
        folder: to make; it must be free.
        site: name of the site.
        hosts: names and addresses under which cameras reach the edge; `localhost` is added.
        now: the time from which they are valid.

    Raises:
        InputError: when the folder is not free, or a host is not a name or an address.
    """
    from e3pose.wire.keys.authority import make_authority, make_certificate

    check_site(site)
    _check_hosts(hosts)
    if folder.is_dir() and any(folder.iterdir()):  # whose certificates would all be worthless
        raise InputError(f"{folder}: folder exists and is not empty, expected a free name")
    check_free(folder)
    authority, authority_key = make_authority(site, now)
    names = list(dict.fromkeys(["localhost", "127.0.0.1", *hosts]))
    edge, edge_key = make_certificate(authority, authority_key, edge_name(site), names, now)
    roll = Roll(site)
    with atomic_folder(folder, private=True) as temporary:
        write_file(temporary / "authority.pem", authority)
        write_file(temporary / "authority.key", authority_key, private=True)
        write_file(temporary / "edge.pem", edge)
        write_file(temporary / "edge.key", edge_key, private=True)
        _write_roll(temporary, roll)
    folder.chmod(0o700)
    return roll


def add_keys(
    folder: Path,
    name: str,
    now: datetime.datetime,
    kind: Kind = "camera",
    again: bool = False,
    hosts: Sequence[str] = (),
    public: bytes | None = None,
) -> Path:
    """Make the certificate of a camera, a viewer, an operator, a hub or a router.

    Args:
        folder: of the site.
        name: of the camera, viewer, operator, hub or router.
        now: the time from which it is valid.
        kind: which of the five.
        again: whether it may replace an earlier one, which is then revoked.
        hosts: names and addresses under which cameras reach a router.
        public: see `authority.read_public`: of a private key that stays where it is; without, one
            is made.

    Returns:
        The folder to carry to that machine.

    Raises:
        InputError: when the name is taken, unless `again`, or another program changes the list.
    """
    check_camera_id(name)
    _check_hosts(hosts)
    with hold(folder / LIST, wait_s=WAIT_S):
        roll = read_roll(folder)
        known = dict(roll.holders[kind])
        if name in known and not again:
            raise InputError(
                f"{folder}: {kind} {name} has a certificate already, "
                "expected --again to replace it and revoke the old one"
            )
        number = roll.newest + 1
        if number > MAX_COUNT:
            raise InputError(f"{folder}/keys.toml: count: found {roll.newest}, expected fewer")
        subject = f"{name[:52]}#{number}"
        names = ["localhost", name] if kind != "router" else ["localhost", "127.0.0.1", name]
        names = list(dict.fromkeys([*names, *hosts]))
        certificate, private = issue(folder, subject, names, now, public=public)
        place = folder / f"{kind}s" / name
        if place.is_symlink() or place.parent.is_symlink():
            raise InputError(f"{place}: found a symbolic link, expected a folder")
        make_folder(place.parent)
        with atomic_folder(place, overwrite=True, ours=(f"{kind}.pem",), private=True) as made:
            if place.is_dir():  # what else lies there stays
                shutil.copytree(place, made, dirs_exist_ok=True)
            write_file(made / "authority.pem", read_bytes(folder / "authority.pem", MAX_PEM_BYTES))
            write_file(made / f"{kind}.pem", certificate)
            (made / f"{kind}.key").unlink(missing_ok=True)  # of who had the name before
            if private:
                write_file(made / f"{kind}.key", private, private=True)
        revoked = (*roll.revoked, known[name]) if name in known else roll.revoked
        known[name] = subject
        _write_roll(folder, replace(roll, **{f"{kind}s": known}, revoked=revoked, count=number))  # type: ignore[arg-type]
        return place


def issue(
    folder: Path,
    subject: str,
    hosts: Sequence[str],
    now: datetime.datetime,
    own: bytes = b"",
    public: bytes | None = None,
) -> tuple[bytes, bytes]:
    """Return certificate and private key, PEM, that the authority of a folder makes.

    See `authority.make_certificate`, and `authority.read_public` for a public key.

    Raises:
        InputError: when the authority, or its key, is not there, and for what is no public key.
    """
    from e3pose.wire.keys.authority import UNREADABLE, make_certificate, read_public

    theirs = None if public is None else read_public(public)
    authority = read_bytes(folder / "authority.pem", MAX_PEM_BYTES)
    key = read_bytes(folder / "authority.key", MAX_PEM_BYTES)
    try:
        return make_certificate(authority, key, subject, hosts, now, own, theirs)
    except UNREADABLE:
        raise InputError(
            f"{folder}: authority.pem, authority.key: found no certificate and its key, "
            "expected those that `e3pose keys init` made"
        ) from None


def revoke_keys(folder: Path, name: str, kind: Kind | None = None) -> Roll:
    """Revoke the certificate of a camera, viewer, operator, hub or router.

    Args:
        folder: of the site.
        name: of the holder.
        kind: of the holder; None for all that have the name.

    Raises:
        InputError: when there is none of that name.
    """
    check_camera_id(name)
    with hold(folder / LIST, wait_s=WAIT_S):
        roll = read_roll(folder)
        asked = {one: names for one, names in roll.holders.items() if kind in (None, one)}
        lost = [names[name] for names in asked.values() if name in names]
        if not lost:
            known = ", ".join(one for names in roll.holders.values() for one in names) or "nobody"
            raise InputError(f"{folder}: found no certificate of {name}, expected one of: {known}")
        left = {
            f"{role}s": {one: given for one, given in names.items() if one != name}
            for role, names in asked.items()
        }
        roll = replace(roll, **left, revoked=(*roll.revoked, *lost))  # type: ignore[arg-type]
        _write_roll(folder, roll)
        return roll


def read_roll(folder: Path) -> Roll:
    """Return the list of a site's folder.

    Raises:
        InputError: when it is missing or not what it should be.
    """
    path = folder / LIST
    if not path.exists():
        raise InputError(
            f"{path}: file not found, expected the folder of e3pose keys init; --keys names another"
        )
    return read_file(_Listed, path, MAX_LIST_BYTES)


def _check_hosts(hosts: Sequence[str]) -> None:
    for host in hosts:
        if not HOST.fullmatch(host):
            raise InputError(f"host {host[:80]!r}: expected a name or an address")


def certificates_in(folder: Path, role: Literal["edge"] | Kind) -> Certificates:
    """Return the files of a folder for a program; raise `InputError` naming a missing one."""
    files = Certificates(folder / "authority.pem", folder / f"{role}.pem", folder / f"{role}.key")
    for path in (files.authority, files.certificate, files.key):
        read_bytes(path, MAX_PEM_BYTES)
    return files


def valid_certificates(folder: Path, role: Literal["edge"] | Kind) -> Certificates:
    """Return the files of a folder for a program; raise `InputError` unless they serve it now."""
    files = certificates_in(folder, role)
    check_certificates(files, datetime.datetime.now(datetime.timezone.utc))
    return files


def link_of(
    role: Literal["edge", "router", "camera"],
    site: str,
    endpoint: Endpoint,
    keys: Path | None,
    upstream: tuple[Endpoint, ...] = (),
    insecure: bool = False,
) -> Link:
    """Return how a program joins its site, with the certificates of its folder.

    Args:
        role: what it is; see `Link` for this and the others.
        site: the name of the site.
        endpoint: where it listens or connects.
        keys: folder of its certificates; None without.
        upstream: routers that it connects to.
        insecure: whether plain `tcp` beyond this machine is allowed.

    Raises:
        InputError: for an endpoint that is not safe, or certificates that do not serve now.
    """
    files = None
    if endpoint.encrypted and keys is not None:
        if problem := expired(certificates_in(keys, role)):
            raise InputError(problem)
        files = valid_certificates(keys, role)
    link = Link(role, site, endpoint, files, upstream, insecure)
    check_link(link)
    return link


def expired(files: Certificates) -> str:
    """Return which certificate of a program has expired, when, and what to do; empty for none.

    Raises:
        InputError: for a certificate that cannot be read.
    """
    from e3pose.wire.keys import authority

    now = datetime.datetime.now(datetime.timezone.utc)
    for path in (files.certificate, files.authority):
        try:
            until = authority.expires(read_bytes(path, MAX_PEM_BYTES))
        except InputError as error:
            raise error.at(path) from None
        if until < now:
            advice = "e3pose keys init` a new folder; copy all"
            if path == files.certificate:
                name = "edge" if path.stem == "edge" else holder(files)
                advice = f"e3pose keys renew {name}` on the edge makes a new one; copy its folder"
            when = f"expired on {until:%Y-%m-%d %H:%M} UTC"
            return f"{path}: certificate {when}: `{advice} here and restart this program"
    return ""


def check_certificates(files: Certificates, now: datetime.datetime) -> None:
    """Raise `InputError` for invalid certificates, before the network error hides the reason."""
    from e3pose.wire.keys.authority import problem_with

    certificate, key, authority = (
        read_bytes(path, MAX_PEM_BYTES) for path in (files.certificate, files.key, files.authority)
    )
    problem = problem_with(certificate, key, authority, now)
    if problem:
        raise InputError(f"{files.certificate}: {problem}")


def _write_roll(folder: Path, roll: Roll) -> None:
    table: dict[str, Any] = {
        "format": "e3pose-keys",
        "version": 1,
        "site": roll.site,
        "count": roll.count,
        "revoked": list(roll.revoked),
        **{f"{kind}s": dict(names) for kind, names in roll.holders.items()},
    }
    written = tomli_w.dumps(table).encode()
    write_file(folder / LIST, written)
    for name in roll.routers:  # to carry there: a router keeps the rules that the edge keeps
        place = folder / "routers" / name
        if place.is_dir() and not place.is_symlink():
            write_file(place / LIST, written)


def holder(files: Certificates) -> str:
    """Return to whom the certificate of a program was given.

    Raises:
        InputError: for a certificate that cannot be read, or that `e3pose keys` did not make.
    """
    from e3pose.wire.keys.authority import common_name

    name = common_name(read_bytes(files.certificate, MAX_PEM_BYTES))
    if not COMMON_NAME.fullmatch(name):
        raise InputError(
            f"{files.certificate}: certificate", f"of {name[:80]!r}", "one that `e3pose keys` made"
        )
    return holder_of(name)
