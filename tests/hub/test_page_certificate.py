"""The hub's page over https takes a renewed certificate without a restart."""

from __future__ import annotations

import datetime
import ssl
from collections.abc import Callable
from pathlib import Path

import pytest

from e3pose.base.errors import InputError
from e3pose.site.web.server import PageServer
from e3pose.wire.keys.authority import make_authority, make_certificate
from e3pose_hub.page import open_page
from e3pose_hub.settings import load_hub

pytestmark = pytest.mark.slow


def write_pair(folder: Path, make: Callable[[], tuple[bytes, bytes]], key: bool = True) -> str:
    """Put a new certificate into the folder; return it as a client gets it."""
    certificate, secret = make()
    (folder / "hub.pem").write_bytes(certificate)
    if key:
        (folder / "hub.key").write_bytes(secret)
    return ssl.DER_cert_to_PEM_cert(ssl.PEM_cert_to_DER_cert(certificate.decode()))


def shown(page: PageServer) -> str:
    return ssl.get_server_certificate(("127.0.0.1", int(page.url.rpartition(":")[2].strip("/"))))


def test_certificate_that_is_not_there_is_told_with_the_file(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\n[view]\ncertificate = "hub.pem"\nkey = "hub.key"\n'
    )
    with pytest.raises(
        InputError, match=r"hub\.toml: view\.certificate, view\.key: found hub\.pem"
    ):
        open_page(load_hub(tmp_path))
    with pytest.raises(InputError, match=r"view\.listen: found 'x', expected HOST:PORT"):
        open_page(load_hub(tmp_path), "x")


def test_renewed_certificate_is_shown_and_a_wrong_pair_is_told_and_not(tmp_path: Path) -> None:
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = make_authority("house", now)

    def make() -> tuple[bytes, bytes]:
        return make_certificate(*authority, "hub", ["localhost", "127.0.0.1"], now)

    first, told = write_pair(tmp_path, make), list[str]()
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\n'
        '[view]\nlisten = "127.0.0.1:0"\ncertificate = "hub.pem"\nkey = "hub.key"\n'
    )
    with open_page(load_hub(tmp_path), report=told.append) as page:
        assert page.running() and shown(page) == first and not told
        write_pair(tmp_path, make, key=False)  # half of a renewal
        assert page.running() and page.running()
        assert shown(page) == first
        assert len(told) == 1 and "the one before is" in told[0]
        second = write_pair(tmp_path, make)
        assert page.running() and shown(page) == second != first
        assert told[1:] == ["certificate of the page renewed"]
        (tmp_path / "hub.key").unlink()  # between two steps of whoever replaces it
        assert page.running() and shown(page) == second
