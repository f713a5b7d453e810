"""Make a phone a camera: its file, a certificate for its page, and the code that it scans.

The certificate is signed by the site's own authority where its key is on this machine, else by one
that is made beside the phones.
"""

from __future__ import annotations

import binascii
import datetime
import hashlib
import io
import socket
import ssl
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.camera.phone_file import CERTIFICATE, CODE_S, KEY, PhoneFile, load_phone, save_phone
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.sources import PHONE
from e3pose.wire.keys.folder import MAX_PEM_BYTES

FIRST_PORT, PORTS = 8481, 100
AUTHORITY = "authority.pem", "authority.key"
SUFFIX = ".toml"


@dataclass(frozen=True, slots=True)
class Shown:
    """Code and address to show to the phone's owner.

    Attributes:
        source: of the camera that the phone becomes.
        url: for the phone, with the code.
        fingerprint: SHA-256 of the certificate that it is shown.
        port: at which it is reached.
        minutes: for which the code is good.
    """

    source: str
    url: str
    fingerprint: str
    port: int
    minutes: int = round(CODE_S / 60)

    def picture(self) -> str:
        """Return the address as a QR code, a `data:` address of an SVG."""
        import segno

        return str(segno.make(self.url, error="m").svg_data_uri(scale=6, border=3, light="#fff"))

    def drawn(self) -> str:
        """Return the address as a QR code for a terminal."""
        import segno

        out = io.StringIO()
        segno.make(self.url, error="l").terminal(out, compact=True, border=2)
        return out.getvalue()


def show_phone(path: Path, keys: Path | None, listen: str | None = None) -> Shown:
    """Make the file of a phone, or take it, and give it a new code; a phone it had is forgotten.

    Args:
        path: of the file, `NAME.toml`; certificates lie beside it.
        keys: folder of the site's certificates; None for an authority of the phones' own.
        listen: address of this machine, in place of any.

    Raises:
        InputError: for a name that no camera can have, or a file of something else.
    """
    check_camera_id(path.stem)
    if path.suffix != SUFFIX:
        raise InputError("phone", repr(path.name[:80]), f"NAME{SUFFIX}")
    make_folder(path.parent)
    phone = load_phone(path) if path.exists() else PhoneFile(_free_port(path.parent))
    if listen is not None:
        phone = PhoneFile(phone.port, listen)
    hosts = [listen] if listen is not None else addresses()
    certificate = _certificate(path.parent, keys, hosts)
    phone, code = phone.with_code(time.time())
    save_phone(path, phone)
    der = ssl.PEM_cert_to_DER_cert(certificate.decode())
    digest = binascii.hexlify(hashlib.sha256(der).digest(), ":").decode().upper()
    url = f"https://{hosts[0]}:{phone.port}/#{code}"
    return Shown(f"{PHONE}{path}", url, digest, phone.port)


def addresses() -> list[str]:
    """Return the IPv4 addresses of this machine, the most reachable one first."""
    import psutil

    found = [
        each.address
        for name, each_of in psutil.net_if_addrs().items()
        for each in each_of
        if each.family == socket.AF_INET and psutil.net_if_stats()[name].isup
    ]
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("192.0.2.1", 9))  # sends nothing: asks which address would
        found.insert(0, str(out.getsockname()[0]))
    found = [each for each in dict.fromkeys(found) if not each.startswith("127.")]
    return [*found, "127.0.0.1"]


def _certificate(folder: Path, keys: Path | None, hosts: list[str]) -> bytes:
    """Return the certificate of the phones' pages, made anew for other addresses or authorities."""
    from e3pose.wire.keys.authority import hosts_of, make_authority, make_certificate, problem_with

    now = datetime.datetime.now(datetime.timezone.utc)
    at = folder if keys is None or not all((keys / name).is_file() for name in AUTHORITY) else keys
    if at == folder and not (folder / AUTHORITY[0]).exists():
        own, own_key = make_authority("phones", now)
        write_file(folder / AUTHORITY[1], own_key, private=True)
        write_file(folder / AUTHORITY[0], own)  # last: where it is, its key is
    authority, key = (read_bytes(at / name, MAX_PEM_BYTES) for name in AUTHORITY)
    names = [*hosts, "localhost"]
    if (folder / CERTIFICATE).exists():
        own, own_key = (read_bytes(folder / name, MAX_PEM_BYTES) for name in (CERTIFICATE, KEY))
        if problem_with(own, own_key, authority, now) is None and hosts_of(own) == names:
            return own
    own, own_key = make_certificate(authority, key, "e3pose phone page", names, now)
    write_file(folder / KEY, own_key, private=True)
    write_file(folder / CERTIFICATE, own)
    return own


def _free_port(folder: Path) -> int:
    """Return a port that no phone of a folder has, and no program at present."""
    taken = set()
    for path in folder.glob(f"*{SUFFIX}"):
        with suppress(InputError):
            taken.add(load_phone(path).port)
    for port in range(FIRST_PORT, FIRST_PORT + PORTS):
        with suppress(OSError), socket.socket() as tried:
            if port not in taken:
                tried.bind(("", port))
                return port
    raise InputError("phone", "no free port", f"one of {FIRST_PORT} to {FIRST_PORT + PORTS - 1}")
