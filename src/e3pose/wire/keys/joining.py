"""A camera joins a site by a code of six digits, which the site shows and a person types there.

    camera -> edge    its name, and its message of SPAKE2 with the code
    edge -> camera    the other message of SPAKE2
    camera -> edge    sealed: its public key
    edge -> camera    sealed: its certificate, that of the authority, and where the edge is
    camera -> edge    sealed: that it kept them; without this, the edge revokes the certificate
    edge -> camera    that it heard this

Each is a line of JSON over TCP. Both sides have one key only if both have one code: who is between
them, or in the place of one, has one try in a million, and the edge lets a code be tried once. The
private key never leaves the camera.
"""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from io import BufferedReader
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import Meta

from e3pose.base.errors import InputError, reason_of
from e3pose.wire.codec import one_line
from e3pose.wire.topics import check_site

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
    from zeroconf import ServiceInfo

CODE_S = 120.0  # for which a code is shown
MAX_LINE = 2**14
SERVICE = "_e3pose-join._tcp.local."
FIND_S, CONNECT_S, ANSWER_S = 3.0, 3.0, 15.0
NOBODY = (
    "press 'Let a camera join' on the page of the site, or type `e3pose keys join site.toml` there"
)
# Nonces of the messages that are sealed with a key, one of each.
TO_EDGE, TO_CAMERA, KEPT = b"camera->edge", b"edge->camera", b"camera: kept"
Pem = Annotated[str, Meta(max_length=4096)]


class JoinLine(msgspec.Struct, omit_defaults=True, forbid_unknown_fields=True, kw_only=True):
    """A line between a camera and the edge, or what one of them seals in it.

    Attributes:
        version: 2; 1 had no last line.
        name: of the camera, in its first line.
        pake: message of SPAKE2.
        sealed: what only who has the code can read or have written.
        problem: why the edge ends it; nobody vouches for it where it is not sealed.
        site: sealed, as all that follows: name of the site.
        port: of the edge.
        hosts: names and addresses that its certificate is for.
        authority: certificate of the site's authority, PEM.
        certificate: of the camera, PEM.
    """

    version: Literal[2]
    name: Annotated[str, Meta(max_length=64)] = ""
    pake: Annotated[bytes, Meta(max_length=33)] = b""
    sealed: Annotated[bytes, Meta(max_length=10_000)] = b""
    problem: Annotated[str, Meta(max_length=300)] = ""
    site: str = ""
    port: Annotated[int, Meta(ge=0, le=65_535)] = 0
    hosts: Annotated[tuple[str, ...], Meta(max_length=100)] = ()
    authority: Pem = ""
    certificate: Pem = ""


class OpenSite(NamedTuple):
    """A site that lets a camera join: its name, empty if it is not known; host and port there."""

    site: str
    address: tuple[str, int]


def join_port(edge_port: int) -> int:
    """Return the port at which cameras join a site, by that of its edge."""
    return edge_port + (1000 if edge_port < 64_536 else -1000)


def line_of(**said: Any) -> bytes:
    """Return a line with some fields of `JoinLine`."""
    return msgspec.json.encode(JoinLine(version=2, **said)) + b"\n"


def read_line(line: bytes) -> JoinLine:
    """Return the message of a line; raise `InputError` for a cut or unexpected one."""
    if not line.endswith(b"\n"):
        raise InputError("the other side ended the connection")
    try:
        return msgspec.json.decode(line, type=JoinLine)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise InputError(f"join: found no message ({one_line(reason_of(error))[:200]})") from None


def answer(code: str, name: str, pake: bytes) -> tuple[bytes, ChaCha20Poly1305]:
    """Return the edge's message of SPAKE2, and the key that it has with who has its code.

    Raises:
        InputError: for what is no message of SPAKE2.
    """
    from spake2 import SPAKE2_B

    side = SPAKE2_B(code.encode(), *_names(name))
    return side.start(), _key(side, pake)


def unseal(key: ChaCha20Poly1305, nonce: bytes, sealed: bytes) -> bytes:
    """Return the other side's sealed message; raise `InputError` where it has another code."""
    from cryptography.exceptions import InvalidTag

    try:
        return key.decrypt(nonce, sealed, None)
    except (InvalidTag, ValueError):
        raise InputError(
            "wrong code, or somebody between camera and edge: every code is good for one try; "
            "have the site show a new one"
        ) from None


def ask_to_join(
    address: tuple[str, int],
    code: str,
    name: str,
    public: bytes,
    keep: Callable[[JoinLine], object],
) -> JoinLine:
    """Return the edge's reply to a camera that has its code.

    Args:
        address: host and port, see `join_port`.
        code: as the site shows it.
        name: of the camera.
        public: its public key, as of `authority.make_key`.
        keep: stores what the edge says; where that fails, the edge revokes the certificate.

    Raises:
        InputError: where nobody listens, the code is wrong, or the edge refuses, with its words.
    """
    from spake2 import SPAKE2_A

    side = SPAKE2_A(code.encode(), *_names(name))
    with ExitStack() as stack:
        try:
            made = stack.enter_context(socket.create_connection(address, CONNECT_S))
            made.settimeout(ANSWER_S)
            stream = stack.enter_context(made.makefile("rb"))
            theirs = _ask(made, stream, line_of(name=name, pake=side.start()))
            key = _key(side, theirs.pake)
            theirs = _ask(made, stream, line_of(sealed=key.encrypt(TO_EDGE, public, None)))
        except OSError as error:
            raise InputError(f"{address[0]}:{address[1]}: {reason_of(error)}: {NOBODY}") from None
        admitted = read_line(unseal(key, TO_CAMERA, theirs.sealed))
        if admitted.problem:
            raise InputError(one_line(admitted.problem))
        check_site(admitted.site)
        keep(admitted)
        try:
            _ask(made, stream, line_of(sealed=key.encrypt(KEPT, b"", None)))
        except (InputError, OSError):
            raise InputError(
                "the site did not hear that the keys were kept: delete them, and join again by a "
                "new code"
            ) from None
    return admitted


def _names(camera: str) -> tuple[bytes, bytes]:
    return f"camera {camera}".encode(), b"edge"


def _key(side: object, pake: bytes) -> ChaCha20Poly1305:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

    try:
        if len(pake) != 33:
            raise ValueError
        return ChaCha20Poly1305(side.finish(pake))  # type: ignore[attr-defined]
    except Exception:  # the library has errors of five kinds for what is no point of the curve
        raise InputError("join", "no message of SPAKE2", "that of a program of e3pose") from None


def _ask(made: socket.socket, stream: BufferedReader, line: bytes) -> JoinLine:
    made.sendall(line)
    if not (came := stream.readline(MAX_LINE)):
        raise InputError(f"the site shows no code any more: {NOBODY}")
    found = read_line(came)
    if found.problem:
        raise InputError(f"the site refused: {one_line(found.problem)}")
    return found


def find_sites(wait_s: float = FIND_S) -> list[OpenSite]:
    """Return the sites of this network that let a camera join at present, as they say.

    Args:
        wait_s: how long to listen for them.
    """
    from zeroconf import ServiceBrowser, Zeroconf

    names: set[str] = set()
    with Zeroconf() as network:
        ServiceBrowser(network, SERVICE, handlers=[lambda **said: names.add(said["name"])])
        threading.Event().wait(wait_s)
        infos = [network.get_service_info(SERVICE, name, 1000) for name in sorted(names)[:8]]
    return [made for one in infos if one and (made := open_site(one))]


def open_site(info: ServiceInfo) -> OpenSite | None:
    """Return a site that was announced, at the first address that answers; None without one."""
    with suppress(ValueError):  # InputError and UnicodeDecodeError are
        site = check_site((info.properties.get(b"site") or b"").decode())
        for host in info.parsed_addresses()[:8]:
            if reaches(at := (host, info.port or 0)):
                return OpenSite(site, at)
    return None


def reaches(address: tuple[str, int]) -> bool:
    """Return whether somebody listens at an address."""
    try:
        socket.create_connection(address, CONNECT_S).close()
    except (OSError, OverflowError):
        return False
    return True


def read_code(typed: str) -> str:
    """Return a code without what people type between digits; raise `InputError` for no code."""
    code = re.sub(r"[\s-]", "", typed)
    if not (len(code) == 6 and code.isascii() and code.isdigit()):
        raise InputError("code", repr(typed[:20]), "the six digits that the site shows")
    return code
