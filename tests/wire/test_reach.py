"""How far a camera comes on its way to the edge."""

from __future__ import annotations

import socket
from typing import Any

import pytest
from tests.cases import each_case
from tests.ports import free_port

from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.reach import reach_edge


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
