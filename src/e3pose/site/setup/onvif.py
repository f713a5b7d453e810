"""Ask an ONVIF camera for the addresses of its streams: GetProfiles and GetStreamUri over SOAP.

Device and media services of ONVIF Profile S. A camera mostly wants a password; it goes as the
digest of WS-Security, or as HTTP digest where a camera asks for that. What answers is believed
about its own host alone, and is bounded: no redirect, no proxy, no document type, 256 KiB.
"""

from __future__ import annotations

import base64
import hashlib
import secrets
import urllib.error
import urllib.request
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from typing import Any
from urllib.parse import quote, urlsplit
from xml.sax.saxutils import escape

from e3pose.base.errors import InputError
from e3pose.store.timed_calls import TimedCalls

ASK_S, WHOLE_S = 4.0, 8.0  # without a byte of an answer, and for all of it
MAX_BYTES, MOST_PROFILES = 2**18, 8
DEVICE, MEDIA = "http://www.onvif.org/ver10/device/wsdl", "http://www.onvif.org/ver10/media/wsdl"
SCHEMA, SOAP = "http://www.onvif.org/ver10/schema", "http://www.w3.org/2003/05/soap-envelope"
SECURITY = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss-"
DIGEST = f"{SECURITY}username-token-profile-1.0#PasswordDigest"


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream that a camera offers.

    Attributes:
        name: that the camera gives it, with its size and rate.
        url: its address, RTSP, with user and password if they were given.
    """

    name: str
    url: str


@dataclass(frozen=True, slots=True)
class Login:
    """User and password; an empty user for none."""

    user: str = ""
    password: str = ""


class Denied(InputError):
    """A camera that wants another user or password."""


def streams_of(service: str, login: Login | None = None) -> list[Stream]:
    """Return the streams of a camera.

    Args:
        service: address of its device service, as it tells when it is discovered.
        login: user and password.

    Raises:
        Denied: where the camera wants a user and a password, or others.
        InputError: where it does not answer, or not as ONVIF has it.
    """
    login = login or Login()
    host = _host(service)
    asking = _Asking(host, login, _ahead(host, service))
    capabilities = f'<GetCapabilities xmlns="{DEVICE}"><Category>Media</Category></GetCapabilities>'
    told = _all(asking.ask(service, capabilities), "Media")
    media = (_text(told[0], "XAddr") if told else "") or service
    profiles = asking.ask(media, f'<GetProfiles xmlns="{MEDIA}"/>')
    found = []
    for profile in _all(profiles, "Profiles")[:MOST_PROFILES]:
        token = profile.get("token", "")[:64]
        answer = asking.ask(media, _stream_question(token))
        url = _text(answer, "Uri")
        if not _own_stream(url, host):
            raise InputError(f"{host}: names the stream {url[:80]!r}, expected one of its own")
        found.append(Stream(_describe(profile), _with_login(url, login)))
    if not found:
        raise InputError(f"{host}: has no stream: set one up on the camera's own page")
    return found


def _own_stream(url: str, host: str) -> bool:
    try:
        parts = urlsplit(url)
    except ValueError:
        return False
    return parts.scheme in ("rtsp", "rtsps") and parts.hostname == host and len(url) <= 400


def parse(content: bytes) -> ElementTree.Element | None:
    """Return the root of an XML text; None if it is invalid or has a document type."""
    try:
        text = content.decode("utf-8-sig")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # no camera sends entities
            return None
        return ElementTree.fromstring(text)
    except (UnicodeDecodeError, ElementTree.ParseError, ValueError):
        return None


@dataclass(frozen=True, slots=True)
class _Asking:
    """Asks one camera; its clock is `ahead` of ours, by which it judges digests."""

    host: str
    login: Login
    ahead: timedelta = timedelta()

    def ask(self, url: str, body: str) -> ElementTree.Element:
        header = _security(self.login, self.ahead) if self.login.user else ""
        envelope = (
            f'<?xml version="1.0" encoding="UTF-8"?><s:Envelope xmlns:s="{SOAP}"><s:Header>{header}'
            f"</s:Header><s:Body>{body}</s:Body></s:Envelope>"
        )
        status, content = self._post(url, envelope.encode())
        root = parse(content)
        reason = "" if root is None else _reason(root)
        if status == 401 or "NotAuthorized" in reason or "not authorized" in reason.lower():
            wanted = "another" if self.login.user else "a"
            raise Denied(f"{self.host}: wants {wanted} user and password, those of the camera")
        if root is None or reason or status != 200:
            raise InputError(f"{self.host}: {reason[:200] or f'answers no ONVIF (HTTP {status})'}")
        return root

    def _post(self, url: str, content: bytes) -> tuple[int, bytes]:
        if _host(url) != self.host:
            raise InputError(f"{self.host}: sends us to {url[:80]!r}, expected itself")
        passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        passwords.add_password(None, url, self.login.user, self.login.password)
        handlers: list[Any] = [urllib.request.ProxyHandler({}), _Stay()]
        if self.login.user:
            handlers.append(urllib.request.HTTPDigestAuthHandler(passwords))
        request = urllib.request.Request(
            url, content, {"Content-Type": "application/soap+xml; charset=utf-8"}
        )
        answers = list[tuple[int, bytes]]()

        def call() -> None:
            opener = urllib.request.build_opener(*handlers)
            try:
                with opener.open(request, timeout=ASK_S) as answer:
                    answers.append((answer.status, answer.read(MAX_BYTES)))
            except urllib.error.HTTPError as error:  # a fault of SOAP comes with status 400 or 500
                answers.append((error.code, error.read(MAX_BYTES)))

        try:  # the timeout of a socket is for each of its bytes: an answer by drops takes days
            TimedCalls(WHOLE_S, lambda: None).call(call)
            return answers[0]
        except (OSError, ValueError) as error:
            why = getattr(getattr(error, "reason", error), "strerror", None) or "no answer in time"
            raise InputError(f"{self.host}: {why.lower()}") from None


class _Stay(urllib.request.HTTPRedirectHandler):
    """Follows no camera to another place."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _ahead(host: str, service: str) -> timedelta:
    """Return by how much a camera's clock is ahead; nothing where it does not tell."""
    try:
        answer = _Asking(host, Login()).ask(service, f'<GetSystemDateAndTime xmlns="{DEVICE}"/>')
        utc = _all(answer, "UTCDateTime")[0]
        parts = [
            int(_text(utc, name)) for name in ["Year", "Month", "Day", "Hour", "Minute", "Second"]
        ]
        theirs = datetime(*parts, tzinfo=timezone.utc)  # type: ignore[misc,arg-type]
    except (Denied, ValueError, IndexError, OverflowError):
        return timedelta()
    return theirs - datetime.now(timezone.utc)


def _stream_question(token: str) -> str:
    return (
        f'<GetStreamUri xmlns="{MEDIA}"><StreamSetup><Stream xmlns="{SCHEMA}">RTP-Unicast</Stream>'
        f'<Transport xmlns="{SCHEMA}"><Protocol>RTSP</Protocol></Transport></StreamSetup>'
        f"<ProfileToken>{escape(token)}</ProfileToken></GetStreamUri>"
    )


def _security(login: Login, ahead: timedelta) -> str:
    """Return a UsernameToken: Base64(SHA-1(nonce + created + password)), WS-Security 1.0."""
    nonce = secrets.token_bytes(16)
    created = (datetime.now(timezone.utc) + ahead).strftime("%Y-%m-%dT%H:%M:%SZ")
    digest = hashlib.sha1(nonce + created.encode() + login.password.encode()).digest()
    coded, secret = (base64.b64encode(each).decode() for each in (nonce, digest))
    return (
        f'<w:Security xmlns:w="{SECURITY}wssecurity-secext-1.0.xsd" '
        f'xmlns:u="{SECURITY}wssecurity-utility-1.0.xsd"><w:UsernameToken>'
        f'<w:Username>{escape(login.user)}</w:Username><w:Password Type="{DIGEST}">{secret}'
        f"</w:Password><w:Nonce>{coded}</w:Nonce><u:Created>{created}</u:Created>"
        "</w:UsernameToken></w:Security>"
    )


def _with_login(url: str, login: Login) -> str:
    if not login.user:
        return url
    scheme, _, rest = url.partition("://")
    who = f"{quote(login.user, safe='')}:{quote(login.password, safe='')}"
    return f"{scheme}://{who}@{rest.rpartition('@')[2] if '@' in rest.split('/')[0] else rest}"


def _describe(profile: ElementTree.Element) -> str:
    """Describe a profile: name, image size, rate."""
    encoder = (_all(profile, "VideoEncoderConfiguration") or [profile])[0]
    width, height = _text(encoder, "Width"), _text(encoder, "Height")
    rate, name = _text(encoder, "FrameRateLimit"), _text(profile, "Name")
    size = f"{width} × {height}" if width.isdigit() and height.isdigit() else ""
    parts = (name[:60] if name.isprintable() else "", size, f"{rate} per second" if rate else "")
    return ", ".join(part[:60] for part in parts if part) or "stream"


def _reason(root: ElementTree.Element) -> str:
    faults = _all(root, "Fault")
    if not faults:
        return ""
    words = " ".join((node.text or "").strip() for node in faults[0].iter())
    return " ".join(words.split())[:300] or "refuses"


def _all(node: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    """Return the elements below one by their local name, whatever their namespace."""
    return [each for each in node.iter() if each.tag.rpartition("}")[2] == name]


def _text(node: ElementTree.Element, name: str) -> str:
    found = _all(node, name)
    return (found[0].text or "").strip() if found else ""


def _host(url: str) -> str:
    try:
        parts = urlsplit(url)
        if parts.scheme in ("http", "https") and parts.hostname and parts.port != 0:
            return parts.hostname
    except ValueError:
        pass
    raise InputError(f"found the service {url[:80]!r}, expected an http address")
