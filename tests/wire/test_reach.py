"""How far a camera comes on its way to the edge."""

from __future__ import annotations

import datetime
import socket
from pathlib import Path
from typing import Any

import pytest
from tests.cases import each_case
from tests.ports import free_port

from e3pose.base.errors import InputError
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.authority import LEAF_DAYS
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, link_of, read_roll
from e3pose.wire.network import open_network
from e3pose.wire.reach import expired_on_the_way, reach_edge


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
