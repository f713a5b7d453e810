"""The file of a phone that is a camera: its port, and who may send.

    anna.toml         port, the code that is shown, the phone that took it; as hashes alone
    page.pem, .key    the certificate of the pages of all phones in that folder

A code is good for one phone and for ten minutes. The phone that shows it is given a secret of its
own, so that a code that somebody photographs later is worth nothing.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tomli_w
from msgspec import Meta

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds, read_file

CERTIFICATE, KEY = "page.pem", "page.key"
MAX_BYTES = 2**14
CODE_S = 600.0
SECRET_BYTES = 24
ANYWHERE = "0.0.0.0"


@dataclass(frozen=True, slots=True)
class PhoneFile:
    """A phone.

    Attributes:
        port: at which its page is, by https.
        listen: address of this machine at which it is reached; by default any.
        code: hash of the code that a phone may take; empty for none.
        until_s: until when it may, seconds since 1970.
        phone: hash of the secret of the phone that sends; empty for none.
        format: `e3pose-phone`.
        version: 1.
    """

    port: Annotated[int, Meta(ge=1, le=65_535)]
    listen: Annotated[str, Meta(min_length=1, max_length=64)] = ANYWHERE
    code: Annotated[str, Meta(max_length=64)] = ""
    until_s: Annotated[float, Meta(ge=0, le=1e12)] = 0.0
    phone: Annotated[str, Meta(max_length=64)] = ""
    format: Literal["e3pose-phone"] = "e3pose-phone"
    version: Literal[1] = 1

    def __post_init__(self) -> None:
        check_bounds(self)

    def with_code(self, now_s: float) -> tuple[PhoneFile, str]:
        """Return it with a new code in place of the phone that it had, and the code."""
        code = secrets.token_urlsafe(SECRET_BYTES)
        return replace(self, code=_hash(code), until_s=now_s + CODE_S, phone=""), code

    def taken(self, code: str, now_s: float) -> tuple[PhoneFile, str]:
        """Return it with the phone that shows a code, and the secret of that phone.

        Raises:
            InputError: for a code that is wrong, used or too old, in words for the phone.
        """
        if not self.code or not hmac.compare_digest(_hash(code), self.code):
            used = "This code was used already, or is not the newest"
            raise InputError(f"{used}: have e3pose show a new one")
        if now_s > self.until_s:
            raise InputError("This code is too old: have e3pose show a new one")
        secret = secrets.token_urlsafe(SECRET_BYTES)
        return replace(self, code="", until_s=0.0, phone=_hash(secret)), secret

    def sends(self, secret: str) -> bool:
        """Return whether a secret is that of its phone."""
        return bool(self.phone) and hmac.compare_digest(_hash(secret), self.phone)


def load_phone(path: Path) -> PhoneFile:
    """Return the content of a phone's file; raise `InputError` for an unreadable one."""
    return read_file(PhoneFile, path, MAX_BYTES)


def save_phone(path: Path, phone: PhoneFile) -> None:
    """Write the file of a phone, for its owner alone."""
    write_file(
        path,
        "# A phone that is a camera; `e3pose phone` shows a new code for it.\n"
        + tomli_w.dumps(asdict(phone)),
        private=True,
    )


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode(errors="replace")).hexdigest()
