"""Users of a hub: viewers and operators of groups of sites, each with a token."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tomli_w
from msgspec import Meta

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.version import Version, version_of
from e3pose.model.camera_fields import check_camera_id
from e3pose_hub.settings import Hub

FORMAT, VERSION = "e3pose-hub-users", 1
NAME = "users.toml"
MAX_BYTES = 2**20
TOKEN_BYTES = 24
WAIT_S = 5.0
Role = Literal["viewer", "operator"]
Group = Annotated[str, Meta(min_length=1, max_length=100)]


class User(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A user of the hub's page.

    Attributes:
        name: in the log of accesses.
        role: a `viewer` reads the pages of sites; an `operator` also controls the sites.
        token_sha256: of the token, hexadecimal; the token itself is nowhere.
        groups: of sites.
    """

    name: str
    role: Role
    token_sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    groups: tuple[Group, ...]

    def page_token(self, site: str) -> str:
        """Return the user's token for the page of a site; another after the next grant."""
        return hmac.new(bytes.fromhex(self.token_sha256), site.encode(), "sha256").hexdigest()


class UsersFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file of a hub's users.

    Attributes:
        format, version: `FORMAT` and `VERSION`.
        user: each once.
    """

    format: str = FORMAT
    version: int = VERSION
    user: tuple[User, ...] = ()


@dataclass(slots=True, eq=False)
class Users:
    """The users of a hub; the access rules of its page ask it.

    Attributes:
        path: their file, which is read again when it is another one.
    """

    path: Path
    _read: tuple[Version | None, tuple[User, ...]] = (None, ())

    def all(self) -> tuple[User, ...]:
        """Return them."""
        version = version_of([self.path])
        if version is None or version != self._read[0]:
            self._read = version, read_users(self.path)
        return self._read[1]

    def page_tokens(self, site: str, group: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the hashes of the tokens of who may see the page of a site, and control it."""
        hashes: dict[str, list[str]] = {"viewer": [], "operator": []}
        for user in self.all():
            if group in user.groups:
                token = user.page_token(site)
                hashes[user.role].append(hashlib.sha256(token.encode()).hexdigest())
        return tuple(hashes["viewer"]), tuple(hashes["operator"])

    def of_token(self, token: str) -> User | None:
        """Return the user of a token; all are compared, so that the time reveals nothing."""
        given = hashlib.sha256(token.encode(errors="replace")).hexdigest()
        found = None
        for user in self.all():
            if hmac.compare_digest(user.token_sha256, given):
                found = user
        return found

    def scope(self, token: str) -> Literal["read", "write"] | None:
        """Return the rights of a token; None for an unknown one."""
        user = self.of_token(token)
        return None if user is None else "write" if user.role == "operator" else "read"


def users_of(hub: Hub) -> Users:
    """Return the users of a hub."""
    return Users(hub.path.parent / NAME)


def read_users(path: Path) -> tuple[User, ...]:
    """Return the users of a file; nobody where there is none.

    Raises:
        InputError: for a file that holds something else.
    """
    if not path.exists():
        return ()
    try:
        found = msgspec.convert(read_toml(path, MAX_BYTES), UsersFile)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {error}") from None
    if (found.format, found.version) != (FORMAT, VERSION):
        kind = f"{found.format[:40]} version {found.version}"
        raise InputError(f"{path}: format: found {kind}, expected {FORMAT} version {VERSION}")
    return found.user


def grant(hub: Hub, name: str, role: Role, groups: tuple[str, ...]) -> str:
    """Add a user, in place of one of that name; return the token, which is shown once.

    Raises:
        InputError: for a name or a group that cannot be.
    """
    check_camera_id(name)
    hub.of_groups(groups)
    token = secrets.token_urlsafe(TOKEN_BYTES)
    digest = hashlib.sha256(token.encode()).hexdigest()
    _change(hub, name, User(name, role, digest, groups))
    return token


def revoke(hub: Hub, name: str) -> None:
    """Remove a user; a page that is open is refused from then on.

    Raises:
        InputError: when there is none of that name.
    """
    known = [user.name for user in read_users(users_of(hub).path)]
    if name not in known:
        names = ", ".join(known)[:300] or "a user: e3pose hub grant"
        raise InputError("user", repr(name[:80]), f"one of {names}" if known else names)
    _change(hub, name, None)


def _change(hub: Hub, name: str, new: User | None) -> None:
    path = users_of(hub).path
    with hold(path, wait_s=WAIT_S):
        users = [user for user in read_users(path) if user.name != name]
        users += [] if new is None else [new]
        table = msgspec.to_builtins(UsersFile(user=tuple(sorted(users, key=lambda u: u.name))))
        write_file(path, tomli_w.dumps(table), private=True)
