"""Mask passwords and tokens in addresses, by what they mean, before a text is shown.

Camera makers put them everywhere: `rtsp://admin:PASSWORD@HOST`, `?token=TOKEN`, in the path
(`/user=admin&password=PASSWORD`, `/user=admin_password=PASSWORD_channel=1`,
`/0/admin:PASSWORD/main`), or as the path itself. All before the last `@` counts as a login, as a
password may hold one.
"""

from __future__ import annotations

import re

MASK = "***"
_NAMES = (  # bounded, so that no long word takes more than its length in time
    r"[\w.-]{0,20}?(?:pas|pwd|psw|secret|token|key|auth|credential|session|sign|ticket)[\w.-]{0,20}?"
    r"|t|p|k|pw|pin|code|sig"
)
_END = r"_[a-z]+=|[\"'):,;.\]]*(?:\s|$)"  # of a value: the next name, or the end of the address
_ADDRESS = re.compile(r"\b([a-z][a-z0-9+.-]{0,20})://(\S+)", re.IGNORECASE)
_PARAMETER = re.compile(rf"(?<![a-z0-9])({_NAMES})=(?:(?!{_END})[^&])+", re.IGNORECASE)
_USER = re.compile(r"[\w.%+-]{1,40}")
_LOGIN = re.compile(r"(?<=/)[^/:?&=]+:(?=[^/])[^/?&\"']+(?=[/?&])")
_RANDOM = re.compile(
    r"(?<=[/=@])(?:(?=[A-Za-z]*\d)(?=[a-z0-9]*[A-Z])(?=[A-Z0-9]*[a-z])[A-Za-z0-9]{14,}"
    r"|[0-9a-f]{20,})(?![A-Za-z0-9])"
)
_ELEMENT = re.compile(  # of a GStreamer pipeline, or of a database's connection
    r"(?<!\S)((?:user-)?(?:pw|password|passwd|pwd|passphrase))\s*=\s*(?:\"[^\"]*\"|'[^']*'|\S+)",
    re.IGNORECASE,
)


def masked(text: str) -> str:
    """Return a text with the passwords and tokens of its addresses masked."""
    return _ADDRESS.sub(_address, _ELEMENT.sub(rf"\1={MASK}", text))


def has_secret(source: str) -> bool:
    """Return whether an address or a pipeline holds a password or a token."""
    return masked(source) != source


def _address(found: re.Match[str]) -> str:
    scheme, rest = found.groups()
    login, _, place = rest.rpartition("@")
    user, colon, password = login.partition(":")
    if not colon:  # the name of a user opens no door
        place, login = rest, ""
    elif password and _USER.fullmatch(user):
        login = f"{user}:{MASK}@"
    else:
        login = f"{MASK}@"
    host = re.split("[/?#]", place, maxsplit=1)[0]
    path = _LOGIN.sub(MASK, _PARAMETER.sub(rf"\1={MASK}", place[len(host) :]))
    return f"{scheme}://{login}{host}{_RANDOM.sub(MASK, path)}"
