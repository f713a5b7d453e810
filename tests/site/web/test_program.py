"""Where a view listens, and what keeps it from listening."""

from __future__ import annotations

import datetime
import os
import socket
import ssl
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from tests.cases import each_case
from tests.memory_transport import Hub
from tests.rigs import looking
from tests.site.tables import resolved_site, write_site

from e3pose.base.child_process import PASSES
from e3pose.base.errors import InputError
from e3pose.settings.site_file import DEFAULT_LISTEN
from e3pose.site.up import end
from e3pose.site.web import address as address_module
from e3pose.site.web.address import address_of, listening_at, take_port, view_program
from e3pose.site.web.program import open_view
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.keys.folder import init_keys
from e3pose.wire.keys.renewal import renew_keys

NOW = datetime.datetime.now(datetime.timezone.utc)
TLS = '[link]\nendpoint = "tls/0.0.0.0:7001"\nkeys = "keys"\n'


def test_view_is_on_loopback_and_no_plain_http_beyond_this_machine(tmp_path: Path) -> None:
    address = address_of(write_site(tmp_path))
    assert (address.host, address.port, address.certificate) == ("127.0.0.1", 8470, None)
    assert "localhost" in address.hosts
    site = write_site(tmp_path, '[view]\nlisten = "0.0.0.0:8470"\n')
    with pytest.raises(InputError, match=r"site\.toml: view\.listen: found 0\.0\.0\.0:8470, plain"):
        address_of(site)
    with pytest.raises(InputError, match=r"--listen: found 0\.0\.0\.0:1, plain http"):
        address_of(site, "0.0.0.0:1")
    open_site = write_site(tmp_path, '[view]\nlisten = "0.0.0.0:8470"\ninsecure = true\n')
    assert address_of(open_site).certificate is None


@each_case("listen", ["8470", "localhost", "127.0.0.1:99999", "a b:1"])
def test_place_that_is_none_is_refused(tmp_path: Path, listen: str) -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        address_of(write_site(tmp_path), listen)
    with pytest.raises(InputError, match=r"view\.listen"):
        write_site(tmp_path, f'[view]\nlisten = "{listen}"\n')


def test_port_that_is_taken_is_an_error_that_names_it(tmp_path: Path) -> None:
    site = resolved_site(tmp_path, looking((4, 0), (0, 4)))
    with open_view(site, "127.0.0.1:0", transport=Hub().join()) as view:
        port = int(view.url.rpartition(":")[2].strip("/"))
        with pytest.raises(InputError, match=f"port {port} is in use"):
            open_view(site, f"127.0.0.1:{port}", transport=Hub().join())
    with open_view(site, f"127.0.0.1:{port}", transport=Hub().join()) as view:  # it is free again
        assert view.running()


def test_default_port_that_is_taken_gives_way_to_the_next_free_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert write_site(tmp_path).view.listen is DEFAULT_LISTEN
    written = f'[view]\nlisten = "{DEFAULT_LISTEN.place}"\n'
    assert write_site(tmp_path, written).view.listen is not DEFAULT_LISTEN
    told = list[str]()
    with listening_at("127.0.0.1", 0) as other:
        assert other.proto == socket.IPPROTO_TCP, "by which asyncio lets answers leave at once"
        port = other.getsockname()[1]
        default = Endpoint("tcp", "127.0.0.1", port)
        monkeypatch.setattr(address_module, "DEFAULT_LISTEN", default)
        site = write_site(tmp_path)
        nobody_asked = replace(site, view=replace(site.view, listen=default))
        address, listening = take_port(nobody_asked, report=told.append)
        with listening:
            assert address.port > port and listening.getsockname()[1] == address.port
            assert told == [f"port {port} is in use: the page is at port {address.port}"]
        asked = write_site(tmp_path, f'[view]\nlisten = "127.0.0.1:{port}"\n')
        for site, listen in ((asked, None), (nobody_asked, f"127.0.0.1:{port}")):
            with pytest.raises(InputError, match=f"port {port} is in use: stop .* or choose"):
                take_port(site, listen)
        address, listening = take_port(asked, fixed=False)
        listening.close()
        assert address.port > port


@pytest.mark.skipif(not PASSES, reason="sockets are not passed on here")
def test_page_of_up_has_its_port_before_it_starts_and_over_restarts(tmp_path: Path) -> None:
    site = resolved_site(tmp_path, looking((4, 0), (0, 4)), '[view]\nlisten = "127.0.0.1:0"\n')
    page, address = view_program(site, tmp_path, print)
    client = socket.create_connection((address.host, address.port))  # waits for whoever serves
    with pytest.raises(InputError, match="is in use"):
        take_port(site.file, f"127.0.0.1:{address.port}")
    handle = int(page.command[page.command.index("--socket") + 1])
    for _ in range(2):  # a restart
        child = os.dup(handle)
        with open_view(site, transport=Hub().join(), handle=child) as view:
            assert view.address.port == address.port
            client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert client.recv(12) == b"HTTP/1.1 200"
        client.close()
        client = socket.create_connection((address.host, address.port))
    client.close()
    end([page])
    with listening_at(address.host, address.port):
        pass


def test_beyond_loopback_it_is_https_by_the_edge_s_certificate_and_a_token(
    tmp_path: Path,
) -> None:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    site = resolved_site(tmp_path, looking((4, 0), (0, 4)), TLS)
    trusted = ssl.create_default_context(cafile=str(tmp_path / "keys" / "authority.pem"))
    with open_view(site, "0.0.0.0:0", transport=Hub().join()) as view:
        assert view.url.startswith("https://localhost:") and not view.rules.open_reading
        with httpx.Client(base_url=view.url, verify=trusted) as client:
            assert client.get("/").status_code == 200
            assert client.get("/api/site").status_code == 401
            bearer = {"Authorization": f"Bearer {view.tokens.read}"}
            assert client.get("/api/site", headers=bearer).json()["site"] == "lab"


def test_renewed_certificate_is_shown_to_new_connections(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    init_keys(keys, "lab", [], NOW - datetime.timedelta(days=100))
    site = resolved_site(tmp_path, looking((4, 0), (0, 4)), TLS)

    def shown(port: int) -> bytes:
        return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate(("127.0.0.1", port)))

    told = list[str]()
    with open_view(site, "0.0.0.0:0", transport=Hub().join(), report=told.append) as view:
        before = shown(view.address.port)
        renew_keys(keys, "edge", NOW)
        assert view.running()
        renewed = ssl.PEM_cert_to_DER_cert((keys / "edge.pem").read_text())
        assert before != renewed == shown(view.address.port)
        assert told == ["certificate of the page renewed"]
        (keys / "edge.key").write_text("half")
        assert view.running() and view.running() and shown(view.address.port) == renewed
        assert len(told) == 2 and "the one before is" in told[1]
