"""Zenoh on loopback: presence, ports and endpoints, and how far a camera comes to its edge."""

from __future__ import annotations

import contextlib
import datetime
import os
import socket
import time
from pathlib import Path
from typing import Any

import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.waiting import eventually
from tests.wire.certified_site import Site

from e3pose.base.errors import InputError
from e3pose.wire.access import Certificates, Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.authority import LEAF_DAYS
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, link_of, read_roll
from e3pose.wire.network import NetworkTransport, check_port, open_network
from e3pose.wire.reach import expired_on_the_way, reach_edge

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
    # Port is checked without opening it.
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


def test_port_at_which_nothing_listens_is_refused() -> None:
    link = Link("camera", "lab", read_endpoint(f"tcp/127.0.0.1:{free_port()}"))
    found = reach_edge(link, "cam0", 0.0)
    assert (found.outcome, found.reason, found.exchange) == ("refused", "", None)


@each_case(
    ("error", "outcome", "reason"),
    [
        (socket.gaierror(-2, "Name or service not known"), "unknown", ""),
        (OSError(113, "No route to host"), "no-route", "No route to host"),
        (TimeoutError("timed out"), "no-route", "timed out"),
    ],
)
def test_what_stops_a_camera_is_told(
    monkeypatch: pytest.MonkeyPatch, error: OSError, outcome: str, reason: str
) -> None:
    def connect(*_: Any) -> None:
        raise error

    monkeypatch.setattr(socket, "create_connection", connect)
    link = Link("camera", "lab", read_endpoint("tls/edge.local:7447"))
    found = reach_edge(link, "cam0", 0.0)
    assert (found.outcome, found.reason, found.expires) == (outcome, reason, None)


@pytest.mark.parametrize("whose", ["nobody", "cam1", "edge"])
def test_a_certificate_that_expired_is_named_with_its_remedy(tmp_path: Path, whose: str) -> None:
    """An edge whose certificate expires goes on; cameras that connect anew are the first to see."""
    now = datetime.datetime.now(datetime.timezone.utc)
    past = now - datetime.timedelta(days=LEAF_DAYS + 3)
    keys, place = tmp_path / "keys", f"127.0.0.1:{free_port()}"
    init_keys(keys, "lab", [], past if whose == "edge" else now)
    add_keys(keys, "cam1", past if whose == "cam1" else now)
    ours = certificates_in(keys / "cameras" / "cam1", "camera")
    endpoint = read_endpoint(f"tls/{place}")
    edge = open_network(
        Link("edge", "lab", endpoint, certificates_in(keys, "edge")), read_roll(keys)
    )
    try:
        said = expired_on_the_way(Link("camera", "lab", endpoint, ours))
    finally:
        edge.close()
    when = f"expired on {past + datetime.timedelta(days=LEAF_DAYS):%Y-%m-%d}"
    assert (when in said) is (whose != "nobody"), said
    if whose == "cam1":
        assert "camera.pem: certificate" in said and "`e3pose keys renew cam1`" in said
        with pytest.raises(InputError, match=r"expired on .* `e3pose keys renew cam1`"):
            link_of("camera", "lab", endpoint, keys / "cameras" / "cam1")
    if whose == "edge":
        assert f"edge at tls/{place} expired" in said and "`e3pose keys renew edge`" in said
        with pytest.raises(InputError, match=r"expired on .* `e3pose keys renew edge`"):
            link_of("edge", "lab", endpoint, keys)


def test_who_has_no_certificates_or_no_edge_is_told_of_none() -> None:
    nowhere = read_endpoint(f"tls/127.0.0.1:{free_port()}")
    assert expired_on_the_way(Link("camera", "lab", nowhere)) == ""
