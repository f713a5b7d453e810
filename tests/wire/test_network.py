"""Zenoh on loopback: presence, ports and endpoints."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from pathlib import Path

import pytest
from tests.waiting import eventually
from tests.wire.certified_site import Site

from e3pose.base.errors import InputError
from e3pose.wire.access import Certificates, Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import NetworkTransport, check_port, open_network

pytestmark = pytest.mark.slow


def listening() -> set[str]:
    """Return the local addresses on which this process listens, as the kernel writes them."""
    inodes = set()
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # another thread closed it meanwhile
            inodes.add(os.readlink(link))
    return {
        line.split()[1]
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and f"socket:[{line.split()[9]}]" in inodes
    }


def test_edge_that_comes_back_is_found_again(site: Site) -> None:
    camera = site.camera("cam1")
    orders: list[bytes] = []
    camera.subscribe("e3pose/lab/order/cam1", lambda t, p: orders.append(p))
    for life in (b"first", b"second"):
        edge = site.edge()

        def heard(edge: NetworkTransport = edge, life: bytes = life) -> bool:
            edge.publish("e3pose/lab/order/cam1", life)
            time.sleep(0.05)
            return life in orders

        assert eventually(heard)
        edge.close()


def test_camera_listens_nowhere_and_the_edge_as_configured(site: Site) -> None:
    before = listening()
    site.camera("cam1")
    assert listening() <= before  # what an earlier test left may end meanwhile
    edge = site.edge()
    assert listening() - before == {f"0100007F:{site.port:04X}"}
    edge.close()


def test_presence_is_noticed_and_its_end(site: Site) -> None:
    edge = site.edge()
    seen: list[tuple[str, bool]] = []
    edge.watch("e3pose/lab/camera/*/alive", lambda t, there: seen.append((t, there)))
    camera = site.camera("cam2")
    camera.be_present("e3pose/lab/camera/cam2/alive")
    camera.be_present("e3pose/lab/camera/cam1/alive")  # not its own
    assert eventually(lambda: ("e3pose/lab/camera/cam2/alive", True) in seen)
    camera.close()
    assert eventually(lambda: ("e3pose/lab/camera/cam2/alive", False) in seen)
    assert not any("cam1" in topic for topic, _ in seen)
    edge.close()


def test_port_that_is_taken_is_reported_with_what_to_do() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError) as orders:
            open_network(Link("edge", "lab", read_endpoint(f"tcp/127.0.0.1:{port}")))
    assert str(orders.value) == (
        f"endpoint tcp/127.0.0.1:{port}: port {port} is in use: stop the program that has it "
        f"(`ss -ltnp 'sport = :{port}'` names it), such as another run of this site, or choose "
        "another port"
    )


def test_port_is_checked_without_opening_it() -> None:
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        check_port(read_endpoint(endpoint))  # nobody listens yet
        taken.listen()
        with pytest.raises(InputError, match="is in use: stop the program"):
            check_port(read_endpoint(endpoint))
    check_port(read_endpoint(endpoint))
    check_port(read_endpoint("tls/192.0.2.1:7447"))  # of another machine: said when it is opened


def test_what_is_wrong_with_an_endpoint_names_no_foreign_source(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / name).write_text("no certificate")
    files = Certificates(tmp_path / "a", tmp_path / "b", tmp_path / "c")
    for link, reason in (
        (
            Link("edge", "lab", read_endpoint("tcp/192.0.2.1:0"), insecure=True),
            "192.0.2.1 is no address of this",
        ),
        (
            Link("edge", "lab", read_endpoint("tcp/host.invalid:7447"), insecure=True),
            "cannot be used: ",
        ),
        (Link("edge", "lab", read_endpoint("tls/127.0.0.1:0"), files), "No private key found"),
    ):
        with pytest.raises(InputError, match=reason) as orders:
            open_network(link)
        assert ".rs" not in str(orders.value) and "cargo" not in str(orders.value)
