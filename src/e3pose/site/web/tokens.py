"""Access tokens of a site: read, or also write."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tomli_w

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.table import read_file
from e3pose.settings.site_file import SiteTable

Scope = Literal["read", "write"]
MAX_BYTES = 2**16
TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")  # may stand in a header and in an address
TOKEN_BYTES = 24
HUB_TOKENS = "hub-tokens"  # folder of a site
HEARD_S = 3600.0  # without a word of a hub, after which its users are out


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a view.

    Attributes:
        format: `e3pose-view-tokens`.
        version: 1.
        read: lets its holder see the site.
        write: lets its holder also control the site.
    """

    format: Literal["e3pose-view-tokens"]
    version: Literal[1]
    read: str
    write: str

    def __post_init__(self) -> None:
        for name, token in (("read", self.read), ("write", self.write)):
            if not TOKEN.fullmatch(token):  # not shown: it may be somebody's secret
                raise InputError(name, "no token", "16 to 128 letters, digits, - and _")
        if self.read == self.write:
            raise InputError("write", "the token for reading", "another")

    def scope(self, token: str) -> Scope | None:
        """Return the scope of a token; None for an unknown one."""
        given = token.encode(errors="replace")
        # Both are compared: the time it takes tells nothing.
        writes = hmac.compare_digest(given, self.write.encode())
        reads = hmac.compare_digest(given, self.read.encode())
        return "write" if writes else "read" if reads else None


@dataclass(slots=True, eq=False)
class PageTokens:
    """The tokens of a site, and those of users whom its hubs let in at present.

    Attributes:
        own: of the site.
        files: one of each hub, which the edge replaces when the hub asks; an old one counts for
            nothing, as nobody could revoke what is in it.
    """

    own: Tokens
    files: tuple[Path, ...] = ()

    def scope(self, token: str) -> Scope | None:
        """See `Tokens.scope`."""
        if (found := self.own.scope(token)) is not None:
            return found
        digest = hashlib.sha256(token.encode(errors="replace")).hexdigest()
        for path in self.files:
            with suppress(OSError, InputError, ValueError):
                if time.time() - path.stat().st_mtime > HEARD_S:
                    continue
                readers, writers = json.loads(read_bytes(path, MAX_BYTES))
                if digest in writers:
                    return "write"
                if digest in readers:
                    return "read"
        return None


def hub_tokens(site: SiteTable) -> dict[str, Path]:
    """Return the files of the tokens of a site's hubs, by hub."""
    return {hub: site.folder / HUB_TOKENS / f"{hub}.json" for hub in site.view.hubs}


def make_tokens() -> Tokens:
    """Return new tokens."""
    read, write = (secrets.token_urlsafe(TOKEN_BYTES) for _ in range(2))
    return Tokens("e3pose-view-tokens", 1, read, write)


def open_tokens(path: Path) -> Tokens:
    """Return the tokens of a file; where there is none, make it with new ones.

    Raises:
        InputError: for a file that holds something else.
    """
    if not path.exists():
        made = make_tokens()
        fields = {name: getattr(made, name) for name in ("format", "version", "read", "write")}
        write_file(
            path,
            "# Who has a token may see the site; who has that for writing may control it.\n"
            "# Delete this file and restart `e3pose view` for new ones.\n" + tomli_w.dumps(fields),
            private=True,
        )
        return made
    return read_file(Tokens, path, MAX_BYTES)
